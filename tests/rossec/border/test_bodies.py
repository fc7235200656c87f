"""Bodies of resources and ROS messages: the same message in two forms, and nothing else."""

import struct
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import Value, encode
from grants.filters.layout import Layout, parse
from rossec.border.conversations import MAX_BODY
from rossec.border.resources import CBOR_BODY, ROS_BODY, from_ros, to_ros
from rossec.errors import BodyRefused
from rossec.node import message_type

BOOL = parse("std_msgs/Bool", "bool data")
ALL = parse(
    "t/All",
    "bool b\nint8 i\nuint64 u\nfloat32 f\nfloat64 d\nstring s\ntime t\nduration e\n"
    "uint8[] o\nuint8[3] p\nint16[] n\nfloat32[2] g\nt/Part[] m\nt/Part one\n"
    "================================================================================\n"
    "MSG: t/Part\nint32 x\nstring y\n",
)
FIELDS: dict[int | str, Value] = {
    "b": True,
    "i": -5,
    "u": 2**64 - 1,
    "f": 1.5,
    "d": -0.1,
    "s": "grün",
    "t": [7, 9],
    "e": [-1, 5],
    "o": b"\x01\x02",
    "p": b"abc",
    "n": [1, -2],
    "g": [0.5, 2.0],
    "m": [{"x": 1, "y": "a"}, {"x": 2, "y": ""}],
    "one": {"x": -1, "y": "z"},
}
MESSAGE = to_ros(encode(FIELDS), CBOR_BODY, ALL)


def test_a_map_of_the_fields_is_what_ros_serializes() -> None:
    begin = struct.pack("<?bQfd", True, -5, 2**64 - 1, 1.5, -0.1)
    assert MESSAGE.startswith(begin + struct.pack("<I", 5) + "grün".encode())
    assert from_ros(MESSAGE, CBOR_BODY, ALL) == encode(FIELDS)
    assert to_ros(encode({"data": True}), CBOR_BODY, BOOL) == b"\x01"
    assert from_ros(b"\0", CBOR_BODY, BOOL) == encode({"data": False})


def test_what_ros_serializes_is_passed_on_as_it_is() -> None:
    assert to_ros(MESSAGE, ROS_BODY, ALL) == MESSAGE
    assert from_ros(MESSAGE, ROS_BODY, ALL) == MESSAGE


def test_a_stamped_message_of_ros() -> None:
    layout = message_type("sensor_msgs/Temperature").layout
    fields: dict[int | str, Value] = {
        "header": {"seq": 3, "stamp": [10, 20], "frame_id": "lamp"},
        "temperature": 20.5,
        "variance": 0.0,
    }
    message = to_ros(encode(fields), CBOR_BODY, layout)
    assert message == struct.pack("<4I4s2d", 3, 10, 20, 4, b"lamp", 20.5, 0.0)
    assert from_ros(message, CBOR_BODY, layout) == encode(fields)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("b", 1, "neither true nor false"),
        ("i", True, "not an integer"),
        ("i", 1.0, "not an integer"),
        ("i", 128, "out of the range"),
        ("u", -1, "out of the range"),
        ("f", "1", "not a number"),
        ("f", True, "not a number"),
        ("f", 1e300, "out of the range"),
        ("s", b"x", "not text"),
        ("t", [1], "secs, nsecs"),
        ("t", [1, 2.0], "secs, nsecs"),
        ("t", [-1, 0], "out of the range"),
        ("o", [1], "byte"),
        ("p", b"ab", "has 2 elements, not 3"),
        ("n", b"ab", "not an array"),
        ("g", [0.5], "has 1 elements, not 2"),
        ("m", {}, "not an array"),
        ("one", {"x": 1}, "exactly the fields x, y"),
        ("one", [], "exactly the fields"),
        ("one", {"x": 1, "y": "", "z": 0}, "exactly the fields"),
        ("s", None, "not text"),
    ],
)
def test_a_field_of_another_kind_is_refused(name: str, value: Value, message: str) -> None:
    with pytest.raises(BodyRefused, match=message):
        to_ros(encode({**FIELDS, name: value}), CBOR_BODY, ALL)


@pytest.mark.parametrize(
    "value", [{}, [], {**FIELDS, "more": 1}, {k: v for k, v in FIELDS.items() if k != "b"}]
)
def test_a_map_with_other_fields_is_refused(value: Value) -> None:
    with pytest.raises(BodyRefused, match="exactly the fields"):
        to_ros(encode(value), CBOR_BODY, ALL)


@pytest.mark.parametrize("form", [ROS_BODY, CBOR_BODY])
def test_every_octet_of_a_message_counts(form: int) -> None:
    for data in (*(MESSAGE[:at] for at in range(len(MESSAGE))), MESSAGE + b"\0"):
        with pytest.raises(BodyRefused):
            from_ros(data, form, ALL)
    body = encode(FIELDS)
    for data in (*(body[:at] for at in range(len(body))), body + b"\0"):
        with pytest.raises(BodyRefused):
            to_ros(data, CBOR_BODY, ALL)


def test_sizes_are_bounded_before_anything_is_read() -> None:
    text = parse("t/Text", "string s")
    for form in (ROS_BODY, CBOR_BODY):
        with pytest.raises(BodyRefused, match="at most 16384"):
            to_ros(bytes(MAX_BODY + 1), form, text)
        with pytest.raises(BodyRefused, match="at most 16384"):
            from_ros(struct.pack("<I", MAX_BODY) + b"a" * MAX_BODY, form, text)


def test_an_array_that_claims_more_than_is_there() -> None:
    empty = parse("t/Many", "t/Empty[] m\n" + "=" * 80 + "\nMSG: t/Empty\n")
    with pytest.raises(BodyRefused, match="an array of"):
        from_ros(struct.pack("<I", 2**32 - 1), CBOR_BODY, empty)


def test_values_that_cbor_cannot_carry() -> None:
    with pytest.raises(BodyRefused, match="that CBOR cannot carry"):
        from_ros(struct.pack("<d", float("nan")), CBOR_BODY, parse("t/F", "float64 d"))
    with pytest.raises(BodyRefused, match="neither 0 nor 1"):
        from_ros(b"\x02", CBOR_BODY, BOOL)
    with pytest.raises(BodyRefused, match="not UTF-8"):
        from_ros(b"\x01\0\0\0\xff", CBOR_BODY, parse("t/Text", "string s"))


@pytest.mark.parametrize("layout", [ALL, BOOL])
@given(data=st.binary(max_size=80))
def test_any_bytes_are_one_message_or_refused(layout: Layout, data: bytes) -> None:
    for form in (ROS_BODY, CBOR_BODY):
        with suppress(BodyRefused):
            message = to_ros(data, form, layout)
            assert to_ros(message, ROS_BODY, layout) == message
        with suppress(BodyRefused):
            from_ros(data, form, layout)
