"""Units of the multiplexer as bytes: each is what CBOR says, and nothing else is taken."""

import cbor2
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import encode
from rossec.errors import StreamRefused
from rossec.overlay.mux import (
    HEADROOM,
    KINDS,
    MASTER,
    MAX_DATA,
    MAX_SEQUENCE,
    NODE,
    Credit,
    Data,
    End,
    Open,
    Reset,
    StreamTarget,
    credit_unit,
    data_head,
    end_unit,
    open_unit,
    read_units,
    reset_unit,
)

STREAMS = st.integers(0, (1 << 32) - 1)
NAMES = st.from_regex(r"(/[A-Za-z][A-Za-z0-9_]{0,9}){1,4}", fullmatch=True)
TARGETS = st.builds(StreamTarget, st.sampled_from(KINDS), NAMES)


@given(STREAMS, TARGETS)
def test_the_opening_of_a_stream(stream: int, target: StreamTarget) -> None:
    unit = open_unit(stream, target)
    assert unit == encode([stream, 0, KINDS.index(target.kind), target.name])
    assert read_units(unit) == [Open(stream, target)]


@given(STREAMS, st.binary(min_size=1, max_size=300) | st.just(bytes(MAX_DATA)))
def test_a_unit_of_data_is_a_head_and_the_payload_itself(stream: int, payload: bytes) -> None:
    head = data_head(stream, len(payload))
    assert len(head) <= HEADROOM
    assert cbor2.loads(head + payload) == [stream, 1, payload]
    received = head + payload
    (unit,) = read_units(received)
    assert isinstance(unit, Data)
    assert unit == Data(stream, memoryview(payload))
    assert unit.payload.obj is received


@given(STREAMS, st.integers(1, (1 << 32) - 1))
def test_the_other_units(stream: int, amount: int) -> None:
    assert cbor2.loads(credit_unit(stream, amount)) == [stream, 2, amount]
    assert cbor2.loads(end_unit(stream)) == [stream, 3]
    assert cbor2.loads(reset_unit(stream)) == [stream, 4]
    joined = credit_unit(stream, amount) + end_unit(stream) + reset_unit(stream)
    assert read_units(joined) == [Credit(stream, amount), End(stream), Reset(stream)]


def test_a_sequence_may_be_empty() -> None:
    assert read_units(b"") == []


@pytest.mark.parametrize(
    "unit",
    [
        open_unit(70000, StreamTarget(NODE, "/robot")),
        data_head(7, 300) + bytes(300),
        credit_unit(1, 65536),
        end_unit(24),
        reset_unit(0),
    ],
    ids=["open", "data", "credit", "end", "reset"],
)
def test_a_unit_that_is_cut_short_is_refused(unit: bytes) -> None:
    for length in range(1, len(unit)):
        with pytest.raises(StreamRefused):
            read_units(unit[:length])
    with pytest.raises(StreamRefused):
        read_units(unit + b"\0")


@pytest.mark.parametrize(
    "data",
    [
        encode([0, 0, 3, "/robot"]),
        encode([0, 0, 1, "robot"]),
        encode([0, 0, 1, "/robot/"]),
        encode([0, 0, 1, "/robót"]),
        encode([0, 0, 1, ""]),
        encode([0, 0, 1, "/" + "r" * 255]),
        encode([0, 0, 1, b"/robot"]),
        encode([0, 0, "node", "/robot"]),
        encode([0, 0, 1, "/robot", 0]),
        encode([0, 0, 1]),
        encode([0, 1, "text"]),
        encode([0, 1, b""]),
        encode([0, 1]),
        encode([0, 1, bytes(MAX_DATA + 1)]),
        encode([0, 2, 0]),
        encode([0, 2, -1]),
        encode([0, 2, 1 << 32]),
        encode([0, 2]),
        encode([0, 3, 0]),
        encode([0, 4, b""]),
        encode([0, 5]),
        encode([0]),
        encode([]),
        encode([-1, 3]),
        encode([1 << 32, 3]),
        encode(["0", 3]),
        encode({0: 3}),
        encode(3),
        bytes.fromhex("82180003"),  # stream 0 in two bytes
        bytes.fromhex("8219000003"),
        bytes.fromhex("821a0000000003"),
        bytes.fromhex("821b000000000000000003"),
        bytes.fromhex("82001803"),  # verb 3 in two bytes
        bytes.fromhex("9f0003ff"),  # of indefinite length
        bytes.fromhex("83000158030102"),
        bytes.fromhex("8300015f4100ff"),
        bytes.fromhex("c1820003"),  # a tag
        bytes.fromhex("82001f"),
    ],
    ids=lambda data: data[:12].hex(),
)
def test_what_is_not_a_unit_is_refused(data: bytes) -> None:
    with pytest.raises(StreamRefused):
        read_units(data)


def test_the_size_is_limited_before_anything_is_read() -> None:
    with pytest.raises(StreamRefused, match="at most"):
        read_units(end_unit(0) * (MAX_SEQUENCE // 3 + 1))


@given(st.binary(max_size=40))
def test_what_is_read_is_the_only_form_of_it(data: bytes) -> None:
    """Whatever is taken, encoding it again gives the same bytes."""
    try:
        units = read_units(data)
    except StreamRefused:
        return
    again = b""
    for unit in units:
        match unit:
            case Open(stream, target):
                again += open_unit(stream, target)
            case Data(stream, payload):
                again += data_head(stream, len(payload)) + bytes(payload)
            case Credit(stream, amount):
                again += credit_unit(stream, amount)
            case End(stream):
                again += end_unit(stream)
            case Reset(stream):
                again += reset_unit(stream)
    assert again == data


def test_a_target_is_shown_with_its_kind() -> None:
    assert str(StreamTarget(MASTER, "/master/ward")) == "master /master/ward"
