"""Read enrollment codes from a picture: a photograph, a screenshot, a frame of a camera.

A shell around pillow and zxing-cpp (the extra `scan`), which are loaded only here. Pictures come
from anywhere: few formats, and the size is judged before anything is unpacked.
"""

import io
from pathlib import Path
from typing import Any, BinaryIO, Final

from ca.qr import PREFIX
from rossec.errors import ConfigurationError

MAX_FILE: Final = 32 * 1024 * 1024
MAX_PIXELS: Final = 64 * 1000 * 1000
_FORMATS: Final = ("PNG", "JPEG", "WEBP", "BMP", "PPM")
_CLOSER: Final = "hold the camera so that the code fills the picture, or paste the text below it"


def code_in_file(path: Path, stdin: BinaryIO) -> str:
    """The text of the one code in a picture; `-` is standard input.

    Raises:
        ConfigurationError: no picture, too large, not exactly one code, or the extra is missing.
    """
    if str(path) == "-":
        return code_in(stdin.read(MAX_FILE + 1))
    with path.open("rb") as file:
        return code_in(file.read(MAX_FILE + 1))


def code_in(data: bytes) -> str:
    """As `code_in_file`, for the bytes of the picture."""
    found = sorted({text for text in _texts(data) if text.startswith(PREFIX)})
    match found:
        case [text]:
            return text
        case []:
            raise ConfigurationError("there is no rossec code in the picture", _CLOSER)
        case _:
            raise ConfigurationError(
                f"there are {len(found)} codes in the picture", "show one of them alone"
            )


def _texts(data: bytes) -> list[str]:
    zxingcpp, image = _library(), _open(data)
    found = zxingcpp.read_barcodes(image, formats=zxingcpp.BarcodeFormat.QRCode)
    return [code.text for code in found]


def _library() -> Any:
    try:
        import zxingcpp  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise _missing() from error
    return zxingcpp


def _open(data: bytes) -> Any:
    try:
        from PIL import Image, UnidentifiedImageError  # noqa: PLC0415 - an extra
    except ImportError as error:
        raise _missing() from error
    if len(data) > MAX_FILE:
        raise ConfigurationError(f"the picture has more than {MAX_FILE} bytes", _CLOSER)
    try:
        image = Image.open(io.BytesIO(data), formats=_FORMATS)
        if image.width * image.height > MAX_PIXELS:
            raise ConfigurationError("the picture has too many pixels", "make it smaller")
        return image.convert("L")
    except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError) as error:
        raise ConfigurationError(
            "this is no picture that can be read", f"take one of {', '.join(_FORMATS)}"
        ) from error


def _missing() -> ConfigurationError:
    return ConfigurationError(
        "reading pictures needs pillow and zxing-cpp",
        "pip install 'rossec[scan]', or paste the text below the code",
    )
