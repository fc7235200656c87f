"""The process that decodes a picture (`python -I -m rossec.enrollment.scanner`): bytes in, one line out.

`rossec.enrollment.enroll` starts it and waits a limited time.
"""

import io
import json
import resource
import sys
from typing import Any, Final

from ca.enrollment.qr import PREFIX
from rossec.errors import ConfigurationError

MAX_FILE: Final = 32 * 1024 * 1024
MAX_PIXELS: Final = 64 * 1000 * 1000
MEMORY: Final = 1536 * 1024 * 1024  # a picture of so many pixels in colour, and some copies
SECONDS: Final = 10
MAX_CODES: Final = 100
CLOSER: Final = "hold the camera so that the code fills the picture, or paste the text below it"
_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "PPM")


def texts(data: bytes) -> list[str]:
    try:
        import zxingcpp  # noqa: PLC0415 - an extra
        from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise ConfigurationError(
            "reading pictures needs pillow and zxing-cpp",
            "pip install 'rossec[scan]', or paste the text below the code",
        ) from error
    if len(data) > MAX_FILE:
        raise ConfigurationError(f"the picture has more than {MAX_FILE} bytes", CLOSER)
    try:
        # Named formats: Pillow has some forty parsers, each of which an attacker could choose.
        opened = Image.open(io.BytesIO(data), formats=_FORMATS)
        # The header says the size; nothing is decoded before it is known.
        if opened.width * opened.height > MAX_PIXELS:
            raise ConfigurationError("the picture has too many pixels", "make it smaller")
        image = opened.convert("L")
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError) as error:
        raise ConfigurationError(
            "this is not a picture that can be read", f"use one of {', '.join(_FORMATS)}"
        ) from error
    qr: Any = zxingcpp.BarcodeFormat.QRCode
    found = zxingcpp.read_barcodes(image, formats=qr)
    return sorted({code.text for code in found if code.text.startswith(PREFIX)})[:MAX_CODES]


def main() -> int:
    # Pictures are untrusted, and the cost of decoding one is not bounded by its size: a few kilobytes full of
    # finder patterns take a minute. No core: it would hold what a camera saw.
    _limit(resource.RLIMIT_AS, MEMORY)
    _limit(resource.RLIMIT_CPU, SECONDS)
    _limit(resource.RLIMIT_CORE, 0)
    try:
        answer: dict[str, Any] = {"texts": texts(sys.stdin.buffer.read(MAX_FILE + 1))}
    except ConfigurationError as error:
        answer = {"error": str(error), "hint": error.hint}
    except MemoryError:
        answer = {"error": "the picture takes more memory than allowed", "hint": CLOSER}
    sys.stdout.write(json.dumps(answer) + "\n")
    return 0


def _limit(what: int, most: int) -> None:
    # Set soft and hard limit, never above the hard limit of this process.
    _, hard = resource.getrlimit(what)
    bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
    resource.setrlimit(what, (bound, bound))


if __name__ == "__main__":
    raise SystemExit(main())
