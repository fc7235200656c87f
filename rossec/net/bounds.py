"""How much a peer may have one connection hold, by what the connection is for.

A unit is assembled before anybody sees it. So who merely has an identity, and whose grants nobody
has looked at, is given no more room than a connection header needs; a subscriber never gets more,
and who was judged as much as its messages can need. How long it may take: `progress`.
"""

from typing import Final

from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.ros.header import HEADER_LIMIT
from rossec.ros.xmlrpc import BODY_LIMIT

PREAUTH_LIMIT: Final = 2 * HEADER_LIMIT  # with whatever was joined to it
BATCH_LIMIT: Final = 2 * 1024 * 1024  # 256 KiB of messages, one more, and 4 bytes for each
_CALLS: Final = ChannelLimits(unit=2 * BODY_LIMIT)  # XML-RPC, with HTTP's headers

ACCEPTED: Final = {
    WireProtocol.HTTP: _CALLS,
    WireProtocol.TCPROS: ChannelLimits(preauth_limit=PREAUTH_LIMIT),
}
"""Of who calls; a caller of a service is made welcome once it may call."""

DIALLED: Final = {WireProtocol.HTTP: _CALLS, WireProtocol.TCPROS: ChannelLimits()}
"""Of who was called, as the master said; messages may follow its header at once."""


def message_limit(size: int | None, most: int) -> int:
    """How long a message may be.

    Args:
        size: of every message of its type, if they are all alike; else None.
        most: how long any may be.
    """
    return most if size is None else min(max(size, HEADER_LIMIT), most)


def unit_limit(size: int | None, most: int) -> int:
    """How long a unit with such messages may be: senders join what is short."""
    return message_limit(size, most) + BATCH_LIMIT
