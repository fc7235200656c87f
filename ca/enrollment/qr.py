"""The text in a node's QR code, and its rendering.

A code authenticates a request that is sent over an untrusted network: it holds the request's
SHA-256. A *label code* holds nothing else and may be printed. A *screen code* adds a one-time
secret, its expiry, and the address the request can be fetched from. The text is `ROSSEC:` + base45
(RFC 9285) of fixed binary, so that it stays in the QR alphanumeric mode; it is never a URL, which
a phone's camera app would open.
"""

from dataclasses import dataclass, field
from hashlib import sha256
from hmac import compare_digest
from io import BytesIO
from typing import Final

import segno

from ca.errors import CodeExpired, CodeRefused

PREFIX: Final = "ROSSEC:"
MAX_TEXT: Final = 512
SECRET_SIZE: Final = 16
_VERSION: Final = 1
_LABEL: Final = 0x10 | _VERSION
_SCREEN: Final = 0x20 | _VERSION
_DIGEST_SIZE: Final = 32
_SCREEN_MINIMUM: Final = 1 + _DIGEST_SIZE + SECRET_SIZE + 4
_MAX_ADDRESS: Final = 64
_ALPHABET: Final = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ $%*+-./:"
_HINT: Final = "scan or paste the whole text the node shows, beginning with ROSSEC:"
# Black on white in every terminal theme: scanners cannot read an inverted code.
_COLOURS: Final = "\x1b[38;5;16;48;5;231m"
_RESET: Final = "\x1b[0m"
_HALF_BLOCKS: Final = {(0, 0): " ", (1, 0): "\u2580", (0, 1): "\u2584", (1, 1): "\u2588"}
_BORDER: Final = 2
_PRINTED_BORDER: Final = 4


@dataclass(frozen=True)
class Code:
    """The content of a code. A label code has no secret, expiry or address."""

    digest: bytes
    secret: bytes = field(default=b"", repr=False)
    expires: int = 0
    address: str = ""

    def matches(self, request: bytes) -> bool:
        """Whether the code was made for `request` (a CSR, DER)."""
        return compare_digest(self.digest, sha256(request).digest())

    def check_time(self, now: int) -> None:
        """Return if the code has not expired; a label code does not expire.

        Raises:
            CodeExpired: a screen code after its expiry.
        """
        if self.secret and now > self.expires:
            raise CodeExpired(
                f"the code expired {now - self.expires} s ago", "have the node show a new one"
            )


def label_code(request: bytes) -> str:
    """Text of a code that only authenticates `request`."""
    return _text(bytes([_LABEL]) + sha256(request).digest())


def screen_code(request: bytes, secret: bytes, expires: int, address: str) -> str:
    """Text of a code that also carries a one-time `secret`, its expiry and the node's address.

    Raises:
        CodeRefused: a secret of another length than 16 bytes, or an address that does not fit.
    """
    if len(secret) != SECRET_SIZE or not 0 < len(address) <= _MAX_ADDRESS or not address.isascii():
        raise CodeRefused(
            "a screen code needs 16 bytes of secret and an address of 1 to 64 ASCII characters",
            "give a shorter one: rossec node enroll NAME --address 192.168.1.7",
        )
    if not 0 <= expires < 1 << 32:
        raise CodeRefused("the expiry of a screen code is out of range")
    encoded_address = address.encode()
    return _text(
        bytes([_SCREEN]) + sha256(request).digest() + secret + expires.to_bytes(4) + encoded_address
    )


def parse(text: str) -> Code:
    """Parse the text of a code as scanned or pasted; surrounding whitespace is ignored.

    Raises:
        CodeRefused: not a rossec code, truncated, or of an unknown version.
    """
    stripped = text.strip()
    if len(stripped) > MAX_TEXT or not stripped.startswith(PREFIX):
        raise CodeRefused("this is not the text of a rossec code", _HINT)
    data = decode_base45(stripped.removeprefix(PREFIX))
    if len(data) == 1 + _DIGEST_SIZE and data[0] == _LABEL:
        return Code(data[1:])
    if len(data) > _SCREEN_MINIMUM and data[0] == _SCREEN:
        return _screen(data)
    if data and data[0] & 0x0F != _VERSION:
        raise CodeRefused(
            "a code of another version of rossec", "update the older of the two sides"
        )
    raise CodeRefused("the code is incomplete or damaged", _HINT)


def terminal(text: str) -> str:
    """The code as half blocks with explicit colours: two modules per line, 19 lines for a label."""
    rows = [
        list(row)
        for row in segno.make_qr(text, error="l", boost_error=False).matrix_iter(border=_BORDER)
    ]
    rows.append([0] * len(rows[0]))  # a QR code has an odd number of rows
    lines = (
        "".join(_HALF_BLOCKS[int(above), int(below)] for above, below in zip(*pair, strict=True))
        for pair in zip(rows[::2], rows[1::2], strict=True)
    )
    return "\n".join(f"{_COLOURS}{line}{_RESET}" for line in lines)


def svg(text: str) -> bytes:
    """The code as an SVG image, for printing."""
    out = BytesIO()
    _printed(text).save(out, kind="svg", scale=4, border=_PRINTED_BORDER)
    return out.getvalue()


def png(text: str) -> bytes:
    """The code as a PNG image, for a screen that shows pictures."""
    out = BytesIO()
    _printed(text).save(out, kind="png", scale=8, border=_PRINTED_BORDER)
    return out.getvalue()


def inline_svg(text: str) -> str:
    """The code as an SVG element that fills the viewport it is put into."""
    element: str = _printed(text).svg_inline(border=_PRINTED_BORDER, omitsize=True, light="white")
    return element


def encode_base45(data: bytes) -> str:
    """Encode `data` (RFC 9285): two bytes become three characters, a last single one two."""
    out = []
    for start in range(0, len(data), 2):
        pair = data[start : start + 2]
        value = int.from_bytes(pair)
        for _ in range(len(pair) + 1):
            value, digit = divmod(value, 45)
            out.append(_ALPHABET[digit])
    return "".join(out)


def decode_base45(text: str) -> bytes:
    """Decode base45 strictly.

    Raises:
        CodeRefused: an invalid character, an incomplete group, or a value out of range.
    """
    out = bytearray()
    for start in range(0, len(text), 3):
        digits = [_ALPHABET.find(char) for char in text[start : start + 3]]
        value = sum(digit * 45**place for place, digit in enumerate(digits))
        size = len(digits) - 1
        if min(digits) < 0 or size == 0 or value >= 1 << (8 * size):
            raise CodeRefused("the text has characters that a rossec code cannot have", _HINT)
        out += value.to_bytes(size)
    return bytes(out)


def _printed(text: str) -> segno.QRCode:
    """Error correction level M, as paper gets dirty (docs/spec/enrollment.md)."""
    return segno.make_qr(text, error="m", boost_error=False)


def _text(data: bytes) -> str:
    return PREFIX + encode_base45(data)


def _screen(data: bytes) -> Code:
    digest, rest = data[1 : 1 + _DIGEST_SIZE], data[1 + _DIGEST_SIZE :]
    encoded_address = rest[SECRET_SIZE + 4 :]
    if not encoded_address.isascii() or len(encoded_address) > _MAX_ADDRESS:
        raise CodeRefused("the address in the code is invalid", _HINT)
    expires = int.from_bytes(rest[SECRET_SIZE : SECRET_SIZE + 4])
    return Code(digest, rest[:SECRET_SIZE], expires, encoded_address.decode())
