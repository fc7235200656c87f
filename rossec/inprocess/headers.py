"""Connection headers over a blocking secure socket: read whole, within a deadline and a limit.

The field that holds grants is binary; rospy, which expects text, does not get it.
"""

import struct
import time
from collections.abc import Mapping
from contextlib import suppress
from typing import Final

from ca.errors import HintedError
from rossec.errors import ChannelClosed, HeaderRefused
from rossec.inprocess.sockets import RosSocket
from rossec.participant.access import FIELD
from rossec.ros import header
from rossec.ros.text import printable

DEADLINE: Final = 5.0
_LENGTH: Final = struct.Struct("<I")


def receive(sock: RosSocket) -> dict[str, bytes]:
    """The fields of the header the peer sends.

    Raises:
        ChannelError, TimeoutError: the connection ended, or nothing came in time.
        HeaderRefused: malformed, or too long.
    """
    end = time.monotonic() + DEADLINE
    (length,) = _LENGTH.unpack(_exactly(sock, _LENGTH.size, end))
    if length > header.HEADER_LIMIT:
        raise HeaderRefused(f"a connection header of {length} bytes")
    return header.decode(_exactly(sock, length, end))


def _exactly(sock: RosSocket, size: int, end: float) -> bytes:
    data = b""
    try:
        while len(data) < size:
            sock.settimeout(max(0.001, end - time.monotonic()))
            part = sock.stream.recv(size - len(data))
            if not part:
                raise ChannelClosed("the peer closed the connection before its header")
            data += part
    finally:
        sock.settimeout(None)
    return data


def for_rospy(fields: Mapping[str, bytes]) -> dict[str, str]:
    """The fields as text, without the one that holds grants."""
    return {key: value.decode(errors="replace") for key, value in fields.items() if key != FIELD}


def refuse(sock: RosSocket, error: HintedError) -> None:
    """Send an authenticated peer the reason; it may be gone."""
    sock.settimeout(DEADLINE)
    with suppress(HintedError, OSError):
        sock.send_unit(header.error_header(f"rossec: {printable(error)}"))
