"""An invitation on an NFC tag: an NDEF message of one record (NFC Forum, NDEF 1.0).

The record is of the type MIME media (TNF 2), `application/vnd.rossec.join`; its payload are the
octets of the code, not its text, so that it fits on the smallest common tag (NTAG213, 144 octets).
A phone that reads the tag opens nothing: only a URI or a well-known type would be acted on. The
reader accepts this one form and no other.
"""

from typing import Final

from ca.enrollment.invitation import InvitationCode, parse_body
from ca.errors import CodeRefused

MEDIA_TYPE: Final = b"application/vnd.rossec.join"
MAX_MESSAGE: Final = 512
# Message begin and end, TNF 2 (NDEF 3.2): with a payload length of one octet, or of four.
_SHORT: Final = 0xD2
_LONG: Final = 0xC2


def write(code: InvitationCode) -> bytes:
    """The NDEF message of an invitation, to be written to a tag."""
    payload = code.body()
    if len(payload) < 256:
        head = bytes([_SHORT, len(MEDIA_TYPE), len(payload)])
    else:
        head = bytes([_LONG, len(MEDIA_TYPE)]) + len(payload).to_bytes(4)
    return head + MEDIA_TYPE + payload


def is_message(data: bytes) -> bool:
    """Whether `data` begins as an NDEF message: the text of a code never does."""
    return data[:1] in {bytes([_SHORT]), bytes([_LONG])}


def read(data: bytes) -> InvitationCode:
    """Read the invitation in an NDEF message.

    Raises:
        CodeRefused: anything else.
    """
    if len(data) <= MAX_MESSAGE and is_message(data):
        start = (3 if data[0] == _SHORT else 6) + len(MEDIA_TYPE)
        code = parse_body(data[start:])
        if write(code) == data:
            return code
    raise CodeRefused(
        "the tag does not hold an invitation of rossec",
        "write it with: rossec ca invite PATTERN --ndef FILE",
    )
