"""Pixelation: compared pixel by pixel, and every inconsistent image."""

import math
import struct
from itertools import groupby, product

import numpy as np
import pytest

from grants.errors import FilterRefused, MessageRefused
from grants.filters.coarsening import PIXEL_SIZES, pixelation
from grants.filters.compile import compile_filter
from grants.filters.layout import Layout, parse
from grants.model import filter_rules
from tests.grants.messages import SEPARATOR, layout, seeded_random, text

IMAGE = f"""Header header
uint32 height
uint32 width
string encoding
uint8 is_bigendian
uint32 step
uint8[] data
{SEPARATOR}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""
LAYOUT = parse("sensor_msgs/Image", IMAGE)


def image(height: int, width: int, encoding: str, step: int, data: bytes) -> bytes:
    head = struct.pack("<III", 1, 2, 3) + text("cam") + struct.pack("<II", height, width)
    return head + text(encoding) + struct.pack("<BII", 0, step, len(data)) + data


def treated(message: bytes, /, _shape: Layout = LAYOUT, **parameters: int) -> bytes:
    rules = filter_rules({"data": {"pixelate": parameters}})
    return b"".join(compile_filter(_shape, rules)(message))


def pixelated(
    data: bytes, height: int, width: int, size: int, step: int, block: int, region: tuple[int, ...]
) -> bytes:
    x, y, wide, high = region
    out = bytearray(len(data))
    for row in range(height):
        for column in range(width):
            inside = x <= column < x + wide and y <= row < y + high
            a, b = (row - row % block, column - column % block) if inside else (row, column)
            at, to = a * step + b * size, row * step + column * size
            out[to : to + size] = data[at : at + size]
    return bytes(out)


@pytest.mark.parametrize("encoding", ["rgb8", "mono8", "rgba16", "32FC1", "8UC3"])
@pytest.mark.parametrize("block", [2, 3, 16, 65535])
@pytest.mark.parametrize("region", [None, (0, 0, 3, 2), (2, 1, 4, 9), (50, 0, 1, 1), (1, 1, 0, 0)])
def test_squares_show_their_first_pixel(encoding: str, block: int, region: tuple[int, ...] | None) -> None:
    size = PIXEL_SIZES[encoding]
    named = dict(zip(("x", "y", "width", "height"), region or (), strict=False))
    for height, width, padding in ((1, 1, 0), (5, 7, 0), (7, 6, 3), (33, 18, 1), (0, 4, 0)):
        step = width * size + padding
        data = seeded_random(height).randbytes(height * step)
        expected = pixelated(data, height, width, size, step, block, region or (0, 0, width, height))
        before, after = (image(height, width, encoding, step, d) for d in (data, expected))
        assert treated(before, LAYOUT, block=block, **named) == after


def test_images_without_pixels() -> None:
    assert pixelation(4, None)(b"abc", 3, 0, "rgb8", 1) == (bytes(3), 3)


@pytest.mark.parametrize(
    "message",
    [
        image(2, 2, "bayer_rggb8", 2, bytes(4)),
        image(2, 2, "yuv422", 4, bytes(8)),
        image(2, 2, "", 2, bytes(4)),
        image(2, 2, "mono8", 2, bytes(5)),
        image(2, 2, "mono8", 2, bytes(3)),
        image(2, 3, "mono8", 2, bytes(4)),
        image(1 << 31, 1 << 31, "mono8", 1 << 31, bytes(4)),
        image(2, 2, "mono8", 2, bytes(4))[:-1],
        image(2, 2, "mono8", 2, bytes(4)) + b"\0",
    ],
)
def test_an_inconsistent_image_is_refused(message: bytes) -> None:
    with pytest.raises(MessageRefused):
        treated(message, block=2)


def test_images_in_a_message_and_in_an_array() -> None:
    fields, header = IMAGE.split(SEPARATOR)
    shape = layout(
        "int32 a\nsensor_msgs/Image one\nsensor_msgs/Image[] many",
        f"MSG: sensor_msgs/Image\n{fields.rstrip()}",
        header.strip(),
    )
    rules = filter_rules({"one.data": {"pixelate": {"block": 2}}, "many[*].data": {"pixelate": {"block": 2}}})
    before, after = (image(1, 2, "mono8", 2, data) for data in (b"ab", b"aa"))
    head = bytes(4)
    made = b"".join(compile_filter(shape, rules)(head + before + (2).to_bytes(4, "little") + before * 2))
    assert made == head + after + (2).to_bytes(4, "little") + after * 2


@pytest.mark.parametrize("other", ["uint8[] data", "uint32 height\nuint8[] data"])
def test_only_image_messages_can_be_pixelated(other: str) -> None:
    for shape in (layout(other), parse("sensor_msgs/Image", other)):
        with pytest.raises(FilterRefused, match="needs the data of a sensor_msgs/Image"):
            treated(b"", shape, block=2)
    behind = parse(
        "sensor_msgs/Image",
        IMAGE.replace("uint8[] data\n", "").replace("uint32 step", "uint8[] data\nuint32 step"),
    )
    with pytest.raises(FilterRefused, match="needs the data"):
        treated(b"", behind, block=2)


def test_siblings_are_read_before_they_are_treated() -> None:
    rules = filter_rules({"data": {"pixelate": {"block": 2}}, "width": {"clear": True}})
    made = b"".join(compile_filter(LAYOUT, rules)(image(1, 2, "mono8", 2, b"ab")))
    assert made == image(1, 0, "mono8", 2, b"aa")


def greyed(pixels: list[list[int]], block: int, levels: int) -> list[list[int]]:
    """The formula of the specification, for one channel."""
    high, wide = len(pixels), len(pixels[0])
    found = [[0] * wide for _ in pixels]
    for r, c in product(range(0, high, block), range(0, wide, block)):
        square = [*product(range(r, min(r + block, high)), range(c, min(c + block, wide)))]
        level = sum(pixels[y][x] for y, x in square) * levels // (256 * len(square))
        for y, x in square:
            found[y][x] = level * 255 // (levels - 1)
    return found


@pytest.mark.parametrize("levels", [2, 8, 256])
@pytest.mark.parametrize(("high", "wide", "block"), [(1, 1, 2), (5, 7, 3), (8, 8, 4), (3, 9, 65535)])
def test_squares_show_their_mean_in_levels_of_grey(high: int, wide: int, block: int, levels: int) -> None:
    data = seeded_random(high * wide).randbytes(high * wide)
    rows = [list(data[r * wide : (r + 1) * wide]) for r in range(high)]
    expected = b"".join(map(bytes, greyed(rows, block, levels)))
    before = image(high, wide, "mono8", wide, data)
    assert treated(before, block=block, levels=levels) == image(high, wide, "mono8", wide, expected)


@pytest.mark.parametrize(("encoding", "size"), [("rgb8", 3), ("8UC3", 3), ("bgra8", 4), ("rgba8", 4)])
def test_colours_become_one_grey_and_opacity_is_lost(encoding: str, size: int) -> None:
    pixels = [(10, 20, 61, 7), (200, 200, 201, 9)]
    padding = b"\x55\x55"
    data = b"".join(bytes(pixel[:size]) for pixel in pixels) + padding
    found = treated(image(1, 2, encoding, 2 * size + 2, data), block=2, levels=256)
    mean = (10 + 20 + 61 + 200 + 200 + 201) * 256 // (256 * 6)
    pixel = bytes([mean] * 3) + bytes([255] * (size - 3))
    assert found.endswith(pixel * 2 + bytes(2))


def side(high: int, wide: int, across: int, block: int = 2) -> int:
    """Of a square, as the specification has it."""
    return max(block, math.ceil(max(high, wide) / across))


SHAPES = [(1, 1), (1, 40), (40, 1), (48, 64), (64, 48), (33, 47), (17, 320), (240, 320)]


@pytest.mark.parametrize(("high", "wide"), SHAPES)
@pytest.mark.parametrize("across", [1, 2, 16, 20, 65535])
def test_so_many_squares_fit_across_at_most(high: int, wide: int, across: int) -> None:
    data = seeded_random(high * wide).randbytes(high * wide)
    before = image(high, wide, "mono8", wide, data)
    for block in (2, 32):
        given = {"across": across} if block == 2 else {"across": across, "block": block}
        same = {"block": side(high, wide, across, block)}
        assert treated(before, LAYOUT, **given) == treated(before, LAYOUT, **same)
        assert treated(before, LAYOUT, levels=8, **given) == treated(before, LAYOUT, levels=8, **same)
    found = np.frombuffer(treated(before, across=across)[-high * wide :], np.uint8)
    rows = found.reshape(high, wide)
    size = side(high, wide, across)
    for axis in (0, 1):
        changes = np.flatnonzero(np.any(np.diff(rows, axis=axis) != 0, axis=1 - axis)) + 1
        assert len(changes) < across
        assert not np.any(changes % size)


def test_a_picture_that_lies_about_its_size_shows_no_more_squares() -> None:
    """The same 40 x 60 bytes as other shapes: 16 values across and no more, in either direction."""
    data = seeded_random(5).randbytes(40 * 60)
    for high, step in ((40, 60), (1, 2400), (2400, 1), (60, 40), (2, 1200), (1200, 2), (48, 50)):
        for wide in {1, step // 2, step} - {0}:
            sent = treated(image(high, wide, "mono8", step, data), across=16)[-2400:]
            assert len(set(sent)) <= 16 * 16 + 1  # and the zeros beside the rows
            rows = [sent[at : at + step] for at in range(0, 2400, step)]
            assert len(set(rows)) <= 16
            assert all(len(list(groupby(row[:wide]))) <= 16 for row in rows)
            assert all(not any(row[wide:]) for row in rows)


def test_a_region_has_the_squares_of_the_whole_picture() -> None:
    """Not of its own size, and a grey is that of the whole square, also beyond the edge."""
    data = bytes(range(64))
    picture = image(8, 8, "mono8", 8, data)
    whole = treated(picture, across=2, levels=256)[-64:]
    found = treated(picture, across=2, levels=256, x=3, y=3, width=2, height=2)[-64:]
    inside = {8 * row + column for row in (3, 4) for column in (3, 4)}
    assert [found[at] for at in range(64)] == [whole[at] if at in inside else data[at] for at in range(64)]


def test_squares_larger_than_32_bits_can_sum() -> None:
    """A column of 17 million white pixels is white, not what is left of an overflow."""
    high = (1 << 24) + (1 << 17)
    assert high * 255 > 1 << 32
    content, length = pixelation(2, None, 8, 1)(b"\xff" * high, high, 1, "mono8", 1)
    assert length == high
    assert set(content) == {255}


@pytest.mark.parametrize(
    "message",
    [
        image(1 << 31, 1 << 31, "mono8", 1 << 31, bytes(4)),
        image(2, 2, "mono8", 2, bytes(5)),
        image(0, 9, "mono8", 2, b""),
        image(2, 2, "bayer_rggb8", 2, bytes(4)),
    ],
)
def test_of_a_size_that_cannot_be_nothing_is_sent(message: bytes) -> None:
    with pytest.raises(MessageRefused):
        treated(message, across=16)


def test_a_region_in_grey_leaves_the_rest() -> None:
    data = bytes(range(16))
    picture = image(4, 4, "mono8", 4, data)
    found = treated(picture, block=2, levels=256, x=0, y=0, width=2, height=2)
    assert found.endswith(bytes([2, 2, 2, 3, 2, 2, 6, 7, *range(8, 16)]))


@pytest.mark.parametrize("encoding", ["mono16", "rgb16", "32FC1", "8UC2", "8SC1", "bayer_rggb8"])
def test_other_encodings_have_no_levels_of_grey(encoding: str) -> None:
    size = PIXEL_SIZES.get(encoding, 1)
    with pytest.raises(MessageRefused):
        treated(image(1, 1, encoding, size, bytes(size)), block=2, levels=8)


def test_a_picture_without_pixels_in_grey() -> None:
    empty = image(0, 0, "mono8", 0, b"")
    assert treated(empty, block=2, levels=8) == empty
