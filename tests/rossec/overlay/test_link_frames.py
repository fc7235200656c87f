"""Frames of a link: what is written is read, and nothing else is."""

import re
from pathlib import Path

import pytest

from rossec.errors import LinkEnded
from rossec.overlay import link_frames as frames
from rossec.overlay.link_frames import HEAD, MAX_BODY, MAX_FRAME, MAX_RANGES, OPEN_SIZE, LinkFrameKind
from tests.support.linknet import ID, REPLY

BODIES = {
    LinkFrameKind.OPEN: frames.return_address(REPLY, OPEN_SIZE - HEAD) + b"first bytes",
    LinkFrameKind.DATA: b"bytes",
    LinkFrameKind.ACK: frames.pack_ranges([(20, 30), (40, 50)]),
    LinkFrameKind.RESET: b"",
    LinkFrameKind.END: b"",
    LinkFrameKind.PROBE: frames.return_address(REPLY, 0),
}
KINDS = sorted(BODIES)


def written(kind: int, body: bytes | None = None, offset: int = 50) -> bytes:
    return frames.head(LinkFrameKind(kind), ID, offset, 10, 99) + (
        BODIES[LinkFrameKind(kind)] if body is None else body
    )


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_a_frame_is_read_as_it_was_written(kind: LinkFrameKind) -> None:
    data = written(kind)
    frame = frames.read(data)
    assert (frame.kind, frame.link, frame.offset, frame.received, frame.limit) == (kind, ID, 50, 10, 99)
    assert frame.body == BODIES[kind]
    assert frames.link_of(data) == ID
    assert frames.kind_of(data) == kind


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_half_a_head_is_no_frame(kind: LinkFrameKind) -> None:
    data = written(kind)
    for length in range(HEAD):
        with pytest.raises(LinkEnded, match="length"):
            frames.read(data[:length])
        assert frames.link_of(data[:length]) is None


def test_what_is_too_long_is_no_frame() -> None:
    longest = written(LinkFrameKind.DATA, bytes(MAX_BODY))
    assert len(longest) == MAX_FRAME
    assert len(frames.read(longest).body) == MAX_BODY
    with pytest.raises(LinkEnded, match="length"):
        frames.read(longest + b"x")
    assert frames.link_of(longest + b"x") is None


@pytest.mark.parametrize(
    ("kind", "size"),
    [
        (LinkFrameKind.OPEN, OPEN_SIZE - HEAD - 1),
        (LinkFrameKind.DATA, 0),
        (LinkFrameKind.ACK, 16 * MAX_RANGES + 16),
        (LinkFrameKind.RESET, 1),
        (LinkFrameKind.END, 1),
        (LinkFrameKind.PROBE, OPEN_SIZE + 1),
    ],
    ids=["OPEN", "DATA", "ACK", "RESET", "END", "PROBE"],
)
def test_a_body_has_a_length_of_its_kind(kind: LinkFrameKind, size: int) -> None:
    with pytest.raises(LinkEnded, match="length that its kind cannot have"):
        frames.read(written(kind, bytes(size)))


@pytest.mark.parametrize("kind", [0, 7, 255])
def test_another_kind_is_refused(kind: int) -> None:
    with pytest.raises(LinkEnded, match="unknown kind"):
        frames.read(bytes((kind,)) + written(LinkFrameKind.DATA)[1:])


@pytest.mark.parametrize("place", [17, 25, 33], ids=["offset", "received", "limit"])
def test_an_offset_that_no_link_reaches_is_refused(place: int) -> None:
    data = bytearray(written(LinkFrameKind.DATA))
    data[place] = 0x80
    with pytest.raises(LinkEnded, match="no link reaches"):
        frames.read(bytes(data))


# -- where to answer


@pytest.mark.parametrize("size", [0, 100, OPEN_SIZE - HEAD])
def test_an_address_is_padded_and_read_again(size: int) -> None:
    body = frames.return_address(REPLY, size)
    assert len(body) == max(size, len(REPLY) + 3)
    key, rest = frames.split_return_address(memoryview(body + b"rest"))
    assert (key, bytes(rest)) == (REPLY, b"rest")


def test_every_part_of_an_address_is_refused() -> None:
    body = frames.return_address(REPLY, 100)
    for length in range(100):
        with pytest.raises(LinkEnded, match="where to answer"):
            frames.split_return_address(memoryview(body[:length]))


@pytest.mark.parametrize(
    "key", ["rossec/1/open/**", "rossec/1/*/" + 32 * "a", "", "rossec/1/öpen/" + 32 * "a"]
)
def test_only_one_inbox_is_answered(key: str) -> None:
    raw = key.encode()
    body = bytes((len(raw),)) + raw + bytes(2)
    with pytest.raises(LinkEnded, match="where to answer"):
        frames.split_return_address(memoryview(body))


def test_padding_carries_nothing() -> None:
    body = bytearray(frames.return_address(REPLY, 100))
    body[-1] = 1
    with pytest.raises(LinkEnded, match="padding"):
        frames.split_return_address(memoryview(body))


# -- what came beyond a gap


def test_ranges_are_read_as_they_were_written() -> None:
    assert frames.read_ranges(frames.read(written(LinkFrameKind.ACK))) == [(20, 30), (40, 50)]
    many = [(100 * at, 100 * at + 1) for at in range(1, 2 * MAX_RANGES)]
    body = frames.pack_ranges(many)
    assert frames.read_ranges(frames.read(written(LinkFrameKind.ACK, body, 10**6))) == many[:MAX_RANGES]


@pytest.mark.parametrize(
    "ranges",
    [[(10, 20)], [(20, 20)], [(30, 20)], [(20, 30), (30, 40)], [(40, 50), (20, 30)], [(20, 51)]],
    ids=["at-received", "empty", "backwards", "joined", "disordered", "unseen"],
)
def test_ranges_out_of_order_are_refused(ranges: list[tuple[int, int]]) -> None:
    with pytest.raises(LinkEnded, match="out of order"):
        frames.read_ranges(frames.read(written(LinkFrameKind.ACK, frames.pack_ranges(ranges))))


def test_half_a_range_is_refused() -> None:
    with pytest.raises(LinkEnded, match="half a range"):
        frames.read_ranges(frames.read(written(LinkFrameKind.ACK, bytes(24))))


def test_a_frame_is_joined_of_pieces() -> None:
    assert frames.joined(b"head", [b"one", bytearray(b"two"), memoryview(b"three")]) == b"headonetwothree"


SPECIFICATION = Path(__file__).parents[3] / "docs" / "spec" / "overlay.md"
ROW = re.compile(r"^\| (\d) \| ([A-Z]+) \|.*\| (\d+)(?: \.\. (\d+))?[^|]*\|$", re.MULTILINE)


def test_the_specification_has_these_kinds_and_lengths() -> None:
    found = ROW.findall(SPECIFICATION.read_text())
    assert {name: int(number) for number, name, _, _ in found} == dict(LinkFrameKind.__members__)
    for _, name, shortest, longest in found:
        for size in {int(shortest), int(longest or shortest)}:
            assert len(frames.read(written(LinkFrameKind[name], bytes(size))).body) == size
        for size in {int(shortest) - 1, int(longest or shortest) + 1} - {-1}:
            with pytest.raises(LinkEnded):
                frames.read(written(LinkFrameKind[name], bytes(size)))
