"""CoAP messages as bytes (RFC 7252 section 3); aiocoap's codec behind a size limit.

Whatever its decoder raises about foreign bytes is one error here. Nothing is sent or remembered.
"""

from typing import Final

from aiocoap import Message
from aiocoap.numbers.codes import Code
from aiocoap.numbers.types import Type

from rossec.errors import DatagramRefused

MAX_DATAGRAM: Final = 1280  # octets; IPv6's smallest MTU, more than a block of 1 KiB sealed
TOKEN_SIZE: Final = 4
CON, NON, ACK, RST = Type.CON, Type.NON, Type.ACK, Type.RST
OBSERVE, DEREGISTER = 0, 1  # RFC 7641 section 2
__all__ = [
    "ACK", "CON", "DEREGISTER", "MAX_DATAGRAM", "NON", "OBSERVE", "RST", "TOKEN_SIZE", "Message",
    "answer", "empty", "is_empty", "number_of", "read", "refusal", "write",
]  # fmt: skip


def read(data: bytes) -> Message:
    """The message in a datagram.

    Raises:
        DatagramRefused: too long, or not a CoAP message.
    """
    if not 4 <= len(data) <= MAX_DATAGRAM:
        raise DatagramRefused(f"a datagram of {len(data)} octets")
    if data[0] & 0x0F > 8 or (data[1] == 0 and len(data) != 4):
        raise DatagramRefused("a token that is too long, or an empty message that is not empty")
    try:
        return Message.decode(data)
    except Exception as error:  # noqa: BLE001 - the codec's errors have no common base
        raise DatagramRefused(f"not a CoAP message: {type(error).__name__}") from None


def write(message: Message) -> bytes:
    """A message as the bytes of a datagram."""
    data: bytes = message.encode()
    return data


def empty(kind: Type, mid: int) -> bytes:
    """An empty acknowledgement or reset."""
    return bytes((0x40 | kind << 4, 0)) + mid.to_bytes(2)


def is_empty(message: Message) -> bool:
    """Whether it has no code: an acknowledgement alone, a reset, or a ping."""
    return int(message.code) == 0


def number_of(message: Message) -> int:
    """Its message ID."""
    return int(message.mid or 0)


def answer(request: Message, response: Message, mid: int) -> Message:
    """Make `response` the answer to `request`: piggybacked, or with `mid` if that was a NON."""
    response.token = request.token
    confirmed = request.mtype == CON
    response.mtype = ACK if confirmed else NON
    response.mid = number_of(request) if confirmed else mid
    return response


def refusal(code: Code) -> Message:
    """An unprotected error: the same for every reason."""
    return Message(code=code)
