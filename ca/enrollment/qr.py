"""The text in a node's QR code, its rendering, sheets of labels, and the code of a domain's bundle.

A code authenticates a request that is sent over an untrusted network: it holds the request's
SHA-256. A *label code* holds nothing else and may be printed. A *screen code* adds a one-time
secret, its expiry, and the address the request can be fetched from. The code of a bundle holds the
bundle's digest.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from hashlib import sha256
from hmac import compare_digest
from html import escape
from io import BytesIO
from typing import TYPE_CHECKING, Final

from ca.errors import BundleRefused, CodeRefused

if TYPE_CHECKING:
    import segno

# `ROSSEC:` and base45 (RFC 9285) of fixed binary stay in the QR alphanumeric mode. It is never a URL, which a
# phone's camera app would open.
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

# A sheet: that of the common A4 sheets of 24 labels; all is drawn in SVG, so that browsers do not
# change the layout. A label holds no secret, so it may stay on the robot.
COLUMNS, ROWS = 3, 8
PER_PAGE: Final = COLUMNS * ROWS
_WIDTH, _HEIGHT = 63.5, 33.9  # millimetres
_STEP: Final = 66.0  # from label to label, sideways
_LEFT, _TOP = 7.25, 12.9
_CODE: Final = 33.0  # with its quiet zone: 0.8 mm a module
_LINE: Final = 17  # characters of a name that fit beside the code
_LINES: Final = 5
_PAGE: Final = (
    '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>rossec labels</title>\n'
    '<meta http-equiv="Content-Security-Policy" content="default-src \'none\'; '
    "style-src 'unsafe-inline'\">\n"
    "<style>@page {{ size: A4; margin: 0 }} body {{ margin: 0 }} "
    "svg.page {{ display: block; break-after: page }}</style></head>\n<body>\n{}</body></html>\n"
)

_TRUST_BUNDLE: Final = 0x51  # the low half is the version
_MAX_TRUST_BUNDLE_TEXT: Final = 64
_TRUST_BUNDLE_HINT: Final = "scan or paste what `rossec domain bundle --qr` shows, beginning with ROSSEC:"


@dataclass(frozen=True)
class Code:
    """The content of a code. A label code has no secret, expiry or address."""

    digest: bytes
    secret: bytes = field(default=b"", repr=False)
    expires: int = 0
    address: str = ""

    def matches(self, request: bytes) -> bool:
        return compare_digest(self.digest, sha256(request).digest())

    def check_time(self, now: int) -> None:
        # Return if the code has not expired; a label code does not expire.
        if self.secret and now > self.expires:
            raise CodeRefused(f"the code expired {now - self.expires} s ago", "have the node show a new one")


def label_code(request: bytes) -> str:
    return PREFIX + encode_base45(bytes([_LABEL]) + sha256(request).digest())


def screen_code(request: bytes, secret: bytes, expires: int, address: str) -> str:
    if len(secret) != SECRET_SIZE or not 0 < len(address) <= _MAX_ADDRESS or not address.isascii():
        raise CodeRefused(
            "a screen code needs 16 bytes of secret and an address of 1 to 64 ASCII characters",
            "give a shorter one: rossec node enroll NAME --address 192.168.1.7",
        )
    if not 0 <= expires < 1 << 32:
        raise CodeRefused("the expiry of a screen code is out of range")
    head = bytes([_SCREEN]) + sha256(request).digest()
    return PREFIX + encode_base45(head + secret + expires.to_bytes(4) + address.encode())


def parse(text: str) -> Code:
    stripped = text.strip()
    if len(stripped) > MAX_TEXT or not stripped.startswith(PREFIX):
        raise CodeRefused("this is not the text of a rossec code", _HINT)
    data = decode_base45(stripped.removeprefix(PREFIX))
    if len(data) == 1 + _DIGEST_SIZE and data[0] == _LABEL:
        return Code(data[1:])
    if len(data) > _SCREEN_MINIMUM and data[0] == _SCREEN:
        digest, rest = data[1 : 1 + _DIGEST_SIZE], data[1 + _DIGEST_SIZE :]
        encoded_address = rest[SECRET_SIZE + 4 :]
        if not encoded_address.isascii() or len(encoded_address) > _MAX_ADDRESS:
            raise CodeRefused("the address in the code is invalid", _HINT)
        expires = int.from_bytes(rest[SECRET_SIZE : SECRET_SIZE + 4])
        return Code(digest, rest[:SECRET_SIZE], expires, encoded_address.decode())
    if data and data[0] & 0x0F != _VERSION:
        raise CodeRefused("a code of another version of rossec", "update the older of the two sides")
    raise CodeRefused("the code is incomplete or damaged", _HINT)


def terminal(text: str) -> str:
    import segno  # noqa: PLC0415 - see `_printed`

    code = segno.make_qr(text, error="l", boost_error=False)
    rows = [list(row) for row in code.matrix_iter(border=_BORDER)]
    rows.append([0] * len(rows[0]))  # a QR code has an odd number of rows
    lines = (
        "".join(_HALF_BLOCKS[int(above), int(below)] for above, below in zip(*pair, strict=True))
        for pair in zip(rows[::2], rows[1::2], strict=True)
    )
    return "\n".join(f"{_COLOURS}{line}{_RESET}" for line in lines)


def svg(text: str) -> bytes:
    out = BytesIO()
    _printed(text).save(out, kind="svg", scale=4, border=_PRINTED_BORDER)
    return out.getvalue()


def png(text: str) -> bytes:
    out = BytesIO()
    _printed(text).save(out, kind="png", scale=8, border=_PRINTED_BORDER)
    return out.getvalue()


def inline_svg(text: str) -> str:
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
    out = bytearray()
    for start in range(0, len(text), 3):
        digits = [_ALPHABET.find(char) for char in text[start : start + 3]]
        value = sum(digit * 45**place for place, digit in enumerate(digits))
        size = len(digits) - 1
        if min(digits) < 0 or size == 0 or value >= 1 << (8 * size):
            raise CodeRefused("the text has characters that a rossec code cannot have", _HINT)
        out += value.to_bytes(size)
    return bytes(out)


def _printed(text: str) -> "segno.QRCode":
    # It takes a tenth of the start of a command, and few that know of codes draw one.
    import segno  # noqa: PLC0415 - see above

    return segno.make_qr(text, error="m", boost_error=False)


@dataclass(frozen=True)
class Label:
    name: str
    fingerprint: str
    text: str


def sheet(labels: Sequence[Label]) -> str:
    pages = []
    for start in range(0, len(labels), PER_PAGE):
        drawn = (_label(at, label) for at, label in enumerate(labels[start : start + PER_PAGE]))
        pages.append(
            '<svg class="page" xmlns="http://www.w3.org/2000/svg" width="210mm" height="297mm" '
            f'viewBox="0 0 210 297"><rect width="210" height="297" fill="white"/>{"".join(drawn)}</svg>\n'
        )
    return _PAGE.format("".join(pages))


def _label(position: int, label: Label) -> str:
    row, column = divmod(position, COLUMNS)
    left, top = _LEFT + column * _STEP, _TOP + row * _HEIGHT
    return (
        f'<svg x="{left}" y="{top}" width="{_WIDTH}" height="{_HEIGHT}">'
        f'<svg width="{_CODE}" height="{_CODE}">{inline_svg(label.text)}</svg>'
        f"{''.join(_lines(label))}</svg>"
    )


def _lines(label: Label) -> Iterator[str]:
    name = [label.name[start : start + _LINE] for start in range(0, len(label.name), _LINE)]
    if len(name) > _LINES:
        name = [*name[: _LINES - 1], "..."]
    digits = label.fingerprint
    groups = [digits[start : start + 10] for start in range(0, len(digits), 10)]  # two groups of four a line
    for number, text in enumerate([*name, *groups]):
        weight = ' font-weight="bold"' if number < len(name) else ""
        yield (
            f'<text x="{_CODE}" y="{5 + 3 * number}" font-family="monospace" font-size="2.6"'
            f"{weight}>{escape(text)}</text>"
        )


def bundle_code(data: bytes) -> str:
    """The text of a code that fits this bundle alone: `ROSSEC:` and 50 characters."""
    return PREFIX + encode_base45(bytes([_TRUST_BUNDLE]) + sha256(data).digest())


def check_code(text: str, data: bytes) -> None:
    """Return if the code `text`, as scanned or pasted, is that of the bundle `data`."""
    stripped = text.strip()
    if not stripped.startswith(PREFIX) or len(stripped) > _MAX_TRUST_BUNDLE_TEXT:
        raise CodeRefused("this is not the code of a bundle", _TRUST_BUNDLE_HINT)
    found = decode_base45(stripped.removeprefix(PREFIX))
    if len(found) != 1 + _DIGEST_SIZE or found[0] != _TRUST_BUNDLE:
        raise CodeRefused("this is not the code of a bundle", _TRUST_BUNDLE_HINT)
    if not compare_digest(found[1:], sha256(data).digest()):
        raise BundleRefused(
            "the bundle does not fit the code: it was changed on its way, or is another one",
            "take the file and the code of the same `rossec domain bundle`",
        )
