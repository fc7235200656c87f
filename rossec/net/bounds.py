"""How much a peer may have one connection hold, by what the connection is for.

A unit is assembled before anybody sees it. So who merely has an identity, and whose grants nobody
has looked at, is given no more room than a connection header needs; a subscriber never gets more.
"""

from typing import Final

from rossec.channel.opening import Flavour
from rossec.channel.records import Limits
from rossec.ros.header import HEADER_LIMIT
from rossec.ros.xmlrpc import BODY_LIMIT

GREETING: Final = 2 * HEADER_LIMIT  # with whatever was joined to it
_CALLS: Final = Limits(unit=2 * BODY_LIMIT)  # XML-RPC, with HTTP's headers

ACCEPTED: Final = {Flavour.HTTP: _CALLS, Flavour.TCPROS: Limits(greeting=GREETING)}
"""Of who calls; a caller of a service is made welcome once it may call."""

DIALLED: Final = {Flavour.HTTP: _CALLS, Flavour.TCPROS: Limits()}
"""Of who was called, as the master said; messages may follow its header at once."""
