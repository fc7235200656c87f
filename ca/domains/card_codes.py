"""The code of a card: its digest, as text that a QR code holds in 19 lines of a terminal.

A card has about 700 octets, and a code of them no place on a screen. Its digest authenticates the
file, which then may come by any way: who scans the code from the other authority's screen need not
compare a fingerprint. It is of another kind than those of enrollment (`ca.enrollment.qr`).
"""

from hashlib import sha256
from hmac import compare_digest
from typing import Final

from ca.enrollment.qr import PREFIX, decode_base45, encode_base45
from ca.errors import CardRefused, CodeRefused

_KIND: Final = 0x51  # the low half is the version
_DIGEST_SIZE: Final = 32
_MAX_TEXT: Final = 64
_HINT: Final = "scan or paste what `rossec domain card --qr` shows, beginning with ROSSEC:"


def card_code(data: bytes) -> str:
    """The text of a code that fits this card alone: `ROSSEC:` and 50 characters."""
    return PREFIX + encode_base45(bytes([_KIND]) + sha256(data).digest())


def check_code(text: str, data: bytes) -> None:
    """Return if the code `text`, as scanned or pasted, is that of the card `data`.

    Raises:
        CodeRefused: not the code of a card.
        CardRefused: that of another card.
    """
    stripped = text.strip()
    if not stripped.startswith(PREFIX) or len(stripped) > _MAX_TEXT:
        raise CodeRefused("this is not the code of a card", _HINT)
    found = decode_base45(stripped.removeprefix(PREFIX))
    if len(found) != 1 + _DIGEST_SIZE or found[0] != _KIND:
        raise CodeRefused("this is not the code of a card", _HINT)
    if not compare_digest(found[1:], sha256(data).digest()):
        raise CardRefused(
            "the card does not fit the code: it was changed on its way, or is another one",
            "take the file and the code of the same `rossec domain card`",
        )
