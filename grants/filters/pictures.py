"""Pixelation: every square of a picture shows the colour of its first pixel.

Squares are aligned with the picture's corner, also in a region, so a moving region reveals no more
than its squares. Padding between the rows of pixels is zeroed. An encoding that is not in the table
is refused: its pixel size is unknown, and a Bayer pattern or YUV 4:2:2 shares colours between
pixels.
"""

from collections.abc import Callable
from typing import Final, TypeAlias

from grants.filters.codegen import Buffer
from grants.filters.lazy_numpy import Vector, np

Region: TypeAlias = tuple[int, ...]  # x, y, width, height
_Pixels: TypeAlias = Vector

MAX_SIDE: Final = 65535

# The fields of a sensor_msgs/Image that are read with its data.
SIBLINGS: Final = (
    ("height", "uint32"), ("width", "uint32"), ("encoding", "string"), ("step", "uint32"),
)  # fmt: skip

# Bytes of a pixel: sensor_msgs/image_encodings.h.
_NAMED: Final = {
    "rgb8": 3, "bgr8": 3, "rgba8": 4, "bgra8": 4, "mono8": 1,
    "rgb16": 6, "bgr16": 6, "rgba16": 8, "bgra16": 8, "mono16": 2,
}  # fmt: skip
_DEPTHS: Final = {"8U": 1, "8S": 1, "16U": 2, "16S": 2, "32S": 4, "32F": 4, "64F": 8}
_GENERIC: Final = {
    f"{depth}C{channels}": size * channels
    for depth, size in _DEPTHS.items()
    for channels in range(1, 5)
}
PIXEL_SIZES: Final = _NAMED | _GENERIC


def pixelation(
    block: int, region: Region | None
) -> Callable[[Buffer, int, int, str, int], tuple[Buffer, int]]:
    """The function from the data, height, width, encoding and step of a picture to its new data.

    It raises ValueError for an unknown encoding, or when the data is not `height` rows.
    """

    def rewrite(
        content: Buffer, height: int, width: int, encoding: str, step: int
    ) -> tuple[Buffer, int]:
        size = PIXEL_SIZES.get(encoding)
        if size is None or width * size > step or height * step != len(content):
            raise ValueError
        if height == 0 or width == 0:
            return bytes(len(content)), len(content)
        x, y, wide, high = region or (0, 0, width, height)
        rows = np.frombuffer(content, np.uint8).reshape(height, step)
        pixels = np.ascontiguousarray(rows[:, : width * size]).view(f"V{size}")
        area = (slice(y, y + high), slice(x, x + wide))
        result = _squares(pixels, block)
        if region is not None:
            whole = pixels.copy()
            whole[area] = result[area]
            result = whole
        padded = np.zeros((height, step), np.uint8)
        padded[:, : width * size] = result.view(np.uint8).reshape(height, -1)
        return padded.tobytes(), len(content)

    return rewrite


def _squares(pixels: _Pixels, block: int) -> _Pixels:
    height, width = pixels.shape
    across = np.repeat(pixels[::block, ::block], min(block, width), axis=1)[:, :width]
    # Few rows are repeated along the row first, then whole rows are copied.
    return np.ascontiguousarray(np.repeat(across, min(block, height), axis=0)[:height])
