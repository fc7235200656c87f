"""How much a peer may have one connection hold, by what the connection is for.

A unit is assembled before it is delivered. So a peer that is authenticated but not yet authorized
may send no more than a connection header needs; a subscriber never more, and an authorized peer as
much as its messages can need. How long it may take: `progress`.
"""

from typing import Final

from rossec.channel.opening import WireProtocol
from rossec.channel.records import ChannelLimits
from rossec.ros.header import HEADER_LIMIT
from rossec.ros.xmlrpc import BODY_LIMIT

PREAUTH_LIMIT: Final = 2 * HEADER_LIMIT  # with what was sent in the same burst
BATCH_LIMIT: Final = 2 * 1024 * 1024  # 256 KiB of messages, one more, and 4 bytes for each
UNSENT: Final = 16 * 1024
"""Bytes that the kernel holds and has not sent yet, above which it takes no more for a receiver
that wishes the newest message only: its own buffer would hold seconds of a slow line."""
_CALLS: Final = ChannelLimits(unit=2 * BODY_LIMIT)  # XML-RPC, with HTTP's headers

ACCEPTED: Final = {
    WireProtocol.HTTP: _CALLS,
    WireProtocol.TCPROS: ChannelLimits(preauth_limit=PREAUTH_LIMIT),
}
"""Of accepted connections; raised for a service client once it is authorized."""

DIALLED: Final = {WireProtocol.HTTP: _CALLS, WireProtocol.TCPROS: ChannelLimits()}
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
