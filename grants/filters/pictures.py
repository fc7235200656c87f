"""Pixelation: every square of a picture shows the colour of its first pixel, or its mean in grey.

The first pixel of a square moves with what moves: ten pictures of a face gave ten samples of it. A
mean alone tells more than one pixel does; few levels of grey are what hides a face (measured:
`python -m bench privacy`). So means come with `levels`, and only in bytes whose meaning is known.

Squares of a fixed number of pixels hide a face in a small picture and show it in a large one, so
they can be given by how many there are across. Whatever sizes a message then claims for its bytes,
no more squares than that leave it in either direction.

Squares are aligned with the picture's corner, also in a region, so a moving region reveals no more
than its squares, which are those of the whole picture: a grey is the mean of its whole square, also
of what lies outside the region. Padding between the rows of pixels is zeroed. An encoding that is
not in the table is refused: its pixel size is unknown, and a Bayer pattern or YUV 4:2:2 shares
colours between pixels.
"""

from collections.abc import Callable
from typing import Final, TypeAlias

from grants.filters.codegen import Buffer
from grants.filters.lazy_numpy import Vector, np

Region: TypeAlias = tuple[int, ...]  # x, y, width, height
_Pixels: TypeAlias = Vector

MAX_SIDE: Final = 65535
_IN_32_BITS: Final = ((1 << 32) - 1) // 255  # so many bytes can be summed

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
# Channels of a byte each: their number, and how many of them are colours. The rest is opacity.
_CHANNELS: Final = {
    "mono8": (1, 1), "8UC1": (1, 1), "rgb8": (3, 3), "bgr8": (3, 3), "8UC3": (3, 3),
    "rgba8": (4, 3), "bgra8": (4, 3),
}  # fmt: skip


def pixelation(
    block: int, region: Region | None, levels: int | None = None, across: int | None = None
) -> Callable[[Buffer, int, int, str, int], tuple[Buffer, int]]:
    """The function from the data, height, width, encoding and step of a picture to its new data.

    Squares have a side of `block` pixels; with `across` a larger one if more than so many would fit
    along the longer side of the picture. With `levels`, they show their mean in so many levels of
    grey. The function raises ValueError for an unknown encoding (with `levels`: also for one of
    more than a byte a channel), or when the data is not `height` rows.
    """

    def rewrite(
        content: Buffer, height: int, width: int, encoding: str, step: int
    ) -> tuple[Buffer, int]:
        size = PIXEL_SIZES.get(encoding) if levels is None else _CHANNELS.get(encoding, (None,))[0]
        if size is None or width * size > step or height * step != len(content):
            raise ValueError
        if height == 0 or width == 0:
            return bytes(len(content)), len(content)
        x, y, wide, high = region or (0, 0, width, height)
        rows = np.frombuffer(content, np.uint8).reshape(height, step)
        pixels = np.ascontiguousarray(rows[:, : width * size]).view(f"V{size}")
        area = (slice(y, y + high), slice(x, x + wide))
        side = block if across is None else max(block, -(-max(height, width) // across))
        if levels is None:
            result = _squares(pixels[::side, ::side], side, pixels.shape)
        else:
            means = _means(pixels, side, levels, _CHANNELS[encoding])
            result = _squares(means, side, pixels.shape)
        if region is not None:
            whole = pixels.copy()
            whole[area] = result[area]
            result = whole
        padded = np.zeros((height, step), np.uint8)
        padded[:, : width * size] = result.view(np.uint8).reshape(height, -1)
        return padded.tobytes(), len(content)

    return rewrite


def _squares(found: _Pixels, block: int, shape: tuple[int, ...]) -> _Pixels:
    """A picture of this shape, each of its squares filled with its pixel in `found`."""
    height, width = shape
    across = np.repeat(found, min(block, width), axis=1)[:, :width]
    # Few rows are repeated along the row first, then whole rows are copied.
    return np.ascontiguousarray(np.repeat(across, min(block, height), axis=0)[:height])


def _means(pixels: _Pixels, block: int, levels: int, channels: tuple[int, int]) -> _Pixels:
    """The pixel of every square: opaque, and the mean of its colours as one of so many greys."""
    every, colours = channels
    height, width = pixels.shape
    values = pixels.view(np.uint8).reshape(height, width * every)
    # Rows first, which lie one after the other. The rest is little.
    wide = np.uint32 if block <= _IN_32_BITS else np.uint64
    rows = np.add.reduceat(values, np.arange(0, height, block), axis=0, dtype=wide)
    sums = rows.reshape(-1, width, every)[..., :colours].sum(axis=2, dtype=np.uint64)
    sums = np.add.reduceat(sums, np.arange(0, width, block), axis=1)
    counts = np.outer(_lengths(height, block), _lengths(width, block)) * np.uint64(256 * colours)
    greys = sums * np.uint64(levels) // counts * np.uint64(255) // np.uint64(levels - 1)
    found = np.full((*greys.shape, every), 255, np.uint8)
    found[..., :colours] = greys[..., np.newaxis]
    return found.reshape(greys.shape[0], -1).view(f"V{every}")


def _lengths(size: int, block: int) -> Vector:
    """How many pixels each square has along a side of `size`."""
    starts = np.arange(0, size, block)
    return np.minimum(block, size - starts).astype(np.uint64)
