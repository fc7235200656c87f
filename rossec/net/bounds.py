"""How much a peer may have one connection hold, by what the connection is for.

A unit is assembled before it is delivered. So a peer that is authenticated but not yet authorized
may send no more than a connection header needs; a subscriber never more, and an authorized peer as
much as its messages can need. How long it may take: `progress`.
"""

from typing import Final

from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.ros.header import HEADER_LIMIT, MESSAGE_LIMIT
from rossec.ros.httpread import HEADERS_LIMIT
from rossec.ros.xmlrpc import BODY_LIMIT

PREAUTH_LIMIT: Final = 2 * HEADER_LIMIT  # with what was sent in the same burst
BATCH_LIMIT: Final = 2 * 1024 * 1024  # 256 KiB of messages, one more, and 4 bytes for each
UNSENT: Final = 16 * 1024
"""Bytes that the kernel holds and has not sent yet, above which it takes no more for a receiver
that wishes the newest message only: its own buffer would hold seconds of a slow line."""
UNSHOWN_BODY: Final = 64 * 1024
"""Bytes of a call that are parsed of a caller that has shown no grant (but those that show one)."""
UNSHOWN_UNIT: Final = 1024 * 1024 + HEADERS_LIMIT
"""Bytes of a call that arrive from such a caller: what is longer than it may be is answered so."""
_CALL: Final = BODY_LIMIT + HEADERS_LIMIT
_CALLS: Final = ChannelLimits(unit=_CALL, preauth_limit=UNSHOWN_UNIT)
_MESSAGES: Final = MESSAGE_LIMIT + BATCH_LIMIT  # in any form of a node

ACCEPTED: Final = {
    WireProtocol.HTTP: _CALLS,
    WireProtocol.TCPROS: ChannelLimits(unit=_MESSAGES, preauth_limit=PREAUTH_LIMIT),
}
"""Of accepted connections; raised once the peer is authorized: a service client, a caller that has
shown a grant, the master."""

DIALLED: Final = {
    WireProtocol.HTTP: ChannelLimits(unit=_CALL),
    WireProtocol.TCPROS: ChannelLimits(unit=_MESSAGES),
}
"""Of connections to addresses from the master; messages may follow the header at once."""


def message_limit(size: int | None, most: int) -> int:
    """How long a message may be.

    Args:
        size: of every message of the type, if it is fixed; else None.
        most: how long any message may be.
    """
    return most if size is None else min(max(size, HEADER_LIMIT), most)


def unit_limit(size: int | None, most: int) -> int:
    """How long a unit with such messages may be: senders batch short messages."""
    return message_limit(size, most) + BATCH_LIMIT
