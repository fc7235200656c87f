"""TCPROS headers and frames: round trips, every refusal, three ways of feeding."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import HeaderRefused, WireError
from rossec.ros import tcpros

FIELDS = {"callerid": b"/robot1/camera", "topic": b"/image", "md5sum": b"*", "note": b"a=b=\x00\xff"}


def field(raw: bytes) -> bytes:
    return struct.pack("<I", len(raw)) + raw


def body(fields: dict[str, bytes]) -> bytes:
    return tcpros.encode(fields)[4:]


def test_round_trip() -> None:
    encoded = tcpros.encode(FIELDS)
    assert struct.unpack_from("<I", encoded)[0] == len(encoded) - 4
    assert tcpros.decode(encoded[4:]) == FIELDS


def test_text_values_are_utf8() -> None:
    fields = tcpros.decode(body({"a": "\u00e9".encode()}))
    assert tcpros.text(fields, "a") == "\u00e9"
    assert tcpros.text(fields, "b", "other") == "other"


def test_empty_header() -> None:
    assert tcpros.decode(b"") == {}


@given(st.dictionaries(st.text("abc_", min_size=1), st.binary(max_size=50)))
def test_decode_undoes_encode(fields: dict[str, bytes]) -> None:
    assert tcpros.decode(tcpros.encode(fields)[4:]) == fields


@given(st.binary(max_size=60))
def test_decodes_or_refuses_and_is_not_malleable(data: bytes) -> None:
    try:
        fields = tcpros.decode(data)
    except HeaderRefused:
        return
    assert body(fields) == data


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (field(b"novalue"), "without '='"),
        (field(b"=x"), "empty or not ASCII"),
        (field(b"\xc3\xa9=x"), "empty or not ASCII"),
        (field(b"a=1") + field(b"a=2"), "appears twice"),
        (field(b"a=1") + b"\x01\x00", "inside a length"),
        (struct.pack("<I", 9) + b"a=1", "beyond its header"),
        (struct.pack("<I", 0x7FFFFFFF) + b"a=1", "at most"),
        (b"x" * (tcpros.HEADER_LIMIT + 1), "at most"),
    ],
)
def test_refuses(data: bytes, message: str) -> None:
    with pytest.raises(HeaderRefused, match=message):
        tcpros.decode(data)


@pytest.mark.parametrize("key", ["", "a=b", "\u00e9"])
def test_refuses_to_write_odd_keys(key: str) -> None:
    with pytest.raises(HeaderRefused, match="cannot be the key"):
        tcpros.encode({key: "x"})


def test_refuses_to_write_too_much() -> None:
    with pytest.raises(HeaderRefused, match="at most 10"):
        tcpros.encode({"key": "x" * 20}, limit=10)


def test_missing_and_undecodable_text() -> None:
    with pytest.raises(HeaderRefused, match="missing"):
        tcpros.text({}, "topic")
    with pytest.raises(HeaderRefused, match="not UTF-8"):
        tcpros.text({"topic": b"\xff"}, "topic")


def test_error_header_is_bounded_and_valid() -> None:
    fields = tcpros.decode(tcpros.error_header("\u00e9" * 5000)[4:])
    assert tcpros.text(fields, "error") == "\u00e9" * 512


FRAMES = [b"one", b"", b"x" * 300]
STREAM = b"".join(map(tcpros.frame, FRAMES))


def test_frames_whole() -> None:
    assert tcpros.FrameReader().feed(STREAM) == FRAMES


def test_frames_byte_by_byte() -> None:
    reader = tcpros.FrameReader()
    frames = [frame for byte in STREAM for frame in reader.feed(bytes([byte]))]
    assert frames == FRAMES
    assert reader.pending == 0


def test_frames_with_a_tail() -> None:
    reader = tcpros.FrameReader()
    assert reader.feed(STREAM + b"\x05\x00") == FRAMES
    assert reader.pending == 2


def test_length_is_refused_before_its_content_comes_and_for_ever() -> None:
    reader = tcpros.FrameReader(10)
    reader.feed(b"\xff\xff\xff")
    for data in (b"\x7f", tcpros.frame(b"ok")):
        with pytest.raises(WireError, match="at most 10"):
            reader.feed(data)


def test_header_and_messages_in_one_unit_have_their_own_limits() -> None:
    reader = tcpros.FrameReader(1000, first=20)
    assert reader.feed(tcpros.frame(b"h" * 20) + tcpros.frame(b"m" * 1000)) == [b"h" * 20, b"m" * 1000]
    with pytest.raises(WireError):
        tcpros.FrameReader(1000, first=20).feed(tcpros.frame(b"h" * 21))


def test_service_replies_keep_their_ok_byte() -> None:
    reader = tcpros.FrameReader(10, first=20, lead=1)
    stream = tcpros.frame(b"head") + b"\x01" + tcpros.frame(b"yes") + b"\x00" + tcpros.frame(b"no")
    frames = [frame for byte in stream for frame in reader.feed(bytes([byte]))]
    assert frames == [b"head", b"\x01yes", b"\x00no"]


def test_frames_are_cut_in_place_where_they_lie_whole() -> None:
    one, two = b"a" * 10, b"b" * 300
    reader = tcpros.FrameReader()
    assert reader.feed(memoryview(tcpros.frame(one) + tcpros.frame(two))) == [one, two]
    stream = tcpros.frame(one) + tcpros.frame(two) + tcpros.frame(one)
    for cut in range(len(stream) + 1):
        reader = tcpros.FrameReader()
        assert reader.feed(stream[:cut]) + reader.feed(stream[cut:]) == [one, two, one]
        assert reader.pending == 0


def test_a_frame_that_arrives_after_its_length_is_not_copied() -> None:
    body = b"x" * 1000
    reader = tcpros.FrameReader()
    assert reader.feed(len(body).to_bytes(4, "little")) == []
    (found,) = reader.feed(body)
    assert found is body
    assert reader.feed(tcpros.frame(b"next")) == [b"next"]


@pytest.mark.parametrize("data", [tcpros.frame(bytes(11)), (11).to_bytes(4, "little")])
def test_a_length_beyond_the_limit_is_refused_in_place_too(data: bytes) -> None:
    reader = tcpros.FrameReader(10)
    with pytest.raises(WireError):
        reader.feed(data)
    with pytest.raises(WireError):
        reader.feed(b"more")
    assert reader.pending == 0


def test_one_frame_at_a_time() -> None:
    reader = tcpros.FrameReader()
    arrived = [reader.feed_one(bytes([byte])) for byte in tcpros.frame(b"abc")]
    assert arrived == [None] * 6 + [b"abc"]
    assert reader.feed_one(tcpros.frame(b"")) == b""
    for _ in range(2):  # and what was refused once stays refused
        with pytest.raises(WireError, match="bytes after a frame, before its answer"):
            reader.feed_one(tcpros.frame(b"abc") + b"x")
