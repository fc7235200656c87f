"""The text that carries a secret to its thing: on a screen, once, or in a file of its owner.

`OSCORE:KID:SECRET` in upper-case hexadecimal digits: it stays in the alphanumeric mode of QR codes,
and a microcontroller reads it in ten lines of C. It is never printed on a label: who sees it can
speak as the thing, and to the thing as its border router.
"""

import re
from typing import Final

from ca.errors import ThingRefused
from ca.things.credentials import MAX_SECRET_KID, SECRET_SIZE

_TEXT: Final = re.compile(
    rf"OSCORE:((?:[0-9A-F]{{2}}){{1,{MAX_SECRET_KID}}}):([0-9A-F]{{{2 * SECRET_SIZE}}})"
)


def secret_text(kid: bytes, secret: bytes) -> str:
    """The text for a thing with this kid and secret.

    Raises:
        ThingRefused: one of them has a wrong length.
    """
    text = f"OSCORE:{kid.hex()}:{secret.hex()}".upper()
    parse_secret(text)
    return text


def parse_secret(text: str) -> tuple[bytes, bytes]:
    """The kid and the secret in such a text; whitespace around it is ignored.

    Raises:
        ThingRefused: it is none.
    """
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise ThingRefused("not the secret of a thing", "OSCORE:KID:SECRET, in hexadecimal digits")
    return bytes.fromhex(found[1]), bytes.fromhex(found[2])
