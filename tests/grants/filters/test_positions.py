"""The operator `rooms` on messages: which types have a position, one by one and in arrays."""

import math
import struct
from typing import Any

import pytest

from grants.errors import FilterRefused, MessageRefused
from grants.filters.compile import compile_filter
from grants.filters.operators import rooms
from grants.model import filter_rules
from tests.grants.messages import layout

PLAN = {"kitchen": "0 0, 4 4", "hall": "4 0, 6 4"}
POINT = "MSG: t/P\nfloat64 x\nfloat64 y\nfloat64 z"
FLAT = "MSG: t/P\nfloat32 x\nfloat32 y\nfloat32 theta"


def treated(fields: str, kind: str, data: bytes, path: str = "p", **more: Any) -> bytes:
    rules = filter_rules({path: {"rooms": {**PLAN, **more}}})
    return b"".join(compile_filter(layout(fields, kind), rules)(data))


def points(*values: float, code: str = "d") -> bytes:
    return struct.pack(f"<{len(values)}{code}", *values)


def test_a_position_between_other_fields() -> None:
    found = treated("uint8 a\nP p\nuint8 b", POINT, b"a" + points(1, 2, 3) + b"b")
    assert found == b"a" + points(2, 2, 0) + b"b"
    assert treated("P p", FLAT, points(5, 1, 0.5, code="f")) == points(5, 2, 0, code="f")
    bare = "MSG: t/P\nfloat64 x\nfloat64 y"
    assert treated("P p", bare, points(5, 1)) == points(5, 2)


def test_a_position_in_no_room_has_no_value() -> None:
    for place in ((-1, 0, 0), (math.nan, 1, 1), (math.inf, 1, 1), (1, -math.inf, 0)):
        found = struct.unpack("<3d", treated("P p", POINT, points(*place)))
        assert all(map(math.isnan, found))


@pytest.mark.parametrize(("fields", "count"), [("P[] p", 3), ("P[2] p", 2), ("P[30] p", 30)])
def test_arrays_of_positions(fields: str, count: int) -> None:
    head = count.to_bytes(4, "little") if "[]" in fields else b""
    before, after = points(*[5, 1, 9] * count), points(*[5, 2, 0] * count)
    assert treated(fields, POINT, head + before) == head + after


def test_positions_inside_of_elements() -> None:
    shape = layout("E[] e", "MSG: t/E\nstring name\nP p", POINT)
    rules = filter_rules({"e[*].p": {"rooms": PLAN}})
    for count in (2, 40):  # one by one, and collected
        name = b"\1\0\0\0a"
        head = count.to_bytes(4, "little")
        data = head + (name + points(1, 1, 1)) * count
        found = b"".join(compile_filter(shape, rules)(data))
        assert found == head + (name + points(2, 2, 0)) * count
    kept = filter_rules({"e[*].p": {"rooms": {**PLAN, "hysteresis": 0.5}}})
    with pytest.raises(FilterRefused, match="hysteresis cannot be used on t/E"):
        compile_filter(shape, kept)


def test_hysteresis_is_remembered_for_a_field() -> None:
    rules = filter_rules({"p": {"rooms": {**PLAN, "hysteresis": 0.5}}})
    compiled = compile_filter(layout("P p", POINT), rules)
    walked = [3.9, 4.3, 4.6, 3.7]
    found = [struct.unpack("<3d", b"".join(compiled(points(x, 1, 0))))[0] for x in walked]
    assert found == [2, 2, 5, 5]


def test_a_message_that_is_too_short_is_refused() -> None:
    with pytest.raises(MessageRefused):
        treated("P p", POINT, bytes(23))


@pytest.mark.parametrize(
    "kind",
    [
        "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        "float64 x\nfloat32 y\nfloat64 z",
        "float64 y\nfloat64 x",
        "int32 x\nint32 y",
        "float64 x",
        "string x\nstring y",
        "float64[2] x\nfloat64[2] y",
    ],
)
def test_other_messages_have_no_position(kind: str) -> None:
    with pytest.raises(FilterRefused, match="p: rooms needs a message of x, y and maybe z"):
        compile_filter(layout("P p", f"MSG: t/P\n{kind}"), filter_rules({"p": {"rooms": PLAN}}))


def test_fields_that_are_no_messages_have_no_position() -> None:
    for fields in ("float64 p", "string p", "float64[3] p", "float64[] p"):
        with pytest.raises(FilterRefused, match="rooms needs a message"):
            compile_filter(layout(fields), filter_rules({"p": {"rooms": PLAN}}))


@pytest.mark.parametrize("reach", [0, -1, 1000.5, math.inf, True, "1"])
def test_a_hysteresis_out_of_range_is_refused(reach: Any) -> None:
    with pytest.raises(FilterRefused, match="hysteresis"):
        rooms({"hysteresis": reach, "a": "0 0, 1 1"})


def test_hysteresis_alone_is_no_plan() -> None:
    with pytest.raises(FilterRefused, match="1 to 64 rooms"):
        rooms({"hysteresis": 1})
