"""Values to bytes: one form for each, and nothing that XML-RPC does not carry."""

import math
import xmlrpc.client
from datetime import datetime
from typing import Any

import cbor2
import pytest
from hypothesis import given

from rossec.ros import xmlrpc as calls
from rossec.ros.compact_values import Pieces, encode_ahead, encoded, encoded_number, encoded_text, put
from rossec.ros.xmlrpc import EncodedList
from tests.rossec.ros.values import VALUES

TIME = "a10071" + b"20261123T09:08:07".hex()
ENCODINGS: list[tuple[Any, str]] = [
    (0, "00"),
    (23, "17"),
    (24, "1818"),
    (255, "18ff"),
    (256, "190100"),
    (65536, "1a00010000"),
    (2**31 - 1, "1a7fffffff"),
    (-1, "20"),
    (-(2**31), "3a7fffffff"),
    (False, "f4"),
    (True, "f5"),
    (1.0, "fb3ff0000000000000"),
    (-0.0, "fb8000000000000000"),
    (math.inf, "fb7ff0000000000000"),
    (-math.nan, "fb7ff8000000000000"),
    ("", "60"),
    ("é", "62c3a9"),
    ("\t\r\n", "63090d0a"),
    ("x" * 24, "7818" + "78" * 24),
    ("x" * 256, "790100" + "78" * 256),
    (b"", "40"),
    (bytearray(b"\x00\xff"), "4200ff"),
    (xmlrpc.client.Binary(b"\x01"), "4101"),
    ([], "80"),
    ((1, [2]), "82018102"),
    ({}, "a0"),
    ({"bb": 1, "a": 2, "b": 3}, "a3616102616203626262" + "01"),
    (datetime.fromisoformat("2026-11-23T09:08:07.000005"), TIME),
    (xmlrpc.client.DateTime("20261123T09:08:07"), TIME),
]


@pytest.mark.parametrize(("value", "written"), ENCODINGS)
def test_each_value_has_this_form(value: object, written: str) -> None:
    assert encoded(value).hex() == written


class Note:
    """An instance, as programs pass them."""

    def __init__(self, text: str) -> None:
        self.text = text


@pytest.mark.parametrize(
    "value",
    [
        None,
        2**31,
        -(2**31) - 1,
        "\x00",
        "\x1f",
        "￾",
        "\ud800",
        {1: 2},
        {"\x07": 1},
        object,
        1j,
        Note("\x00"),
        xmlrpc.client.DateTime("\x00"),
    ],
)
def test_what_xml_rpc_cannot_carry_is_refused(value: object) -> None:
    for whole in (value, [value], {"a": value}):
        with pytest.raises(calls.NOT_ENCODABLE):
            encoded(whole)


def test_an_instance_is_the_struct_that_the_library_makes_of_it() -> None:
    class Pose:
        def __init__(self) -> None:
            self.x, self.tags = 1.5, ("a",)

    assert encoded(Pose()) == encoded({"x": 1.5, "tags": ["a"]})


def test_depth_is_bounded() -> None:
    value: object = "deep"
    for _ in range(40):
        value = [value]
    encoded(value)
    with pytest.raises(ValueError, match="deeper than 40"):
        encoded([value])
    with pytest.raises(ValueError, match="deeper than 40"):
        encoded({"a": value})
    ring: list[object] = []
    ring.append(ring)
    with pytest.raises(ValueError, match="deeper"):
        encoded(ring)


def test_a_list_is_encoded_ahead_and_counted() -> None:
    inner = encode_ahead(EncodedList(["/a", ["/n"]]))
    assert inner.compact == encoded(["/a", ["/n"]])
    outer = EncodedList([[inner, inner], []])
    out = Pieces()
    put(outer, out)
    put(outer, out)
    assert b"".join(out) == encoded([[["/a", ["/n"]], ["/a", ["/n"]]], []]) * 2
    assert out.values == 2 * (1 + 1 + 2 * 4 + 1)
    assert outer.text == EncodedList([[["/a", ["/n"]], ["/a", ["/n"]]], []]).text


def test_numbers_and_texts_alone() -> None:
    assert encoded_number(-25) == b"\x38\x18"
    assert encoded_text("a") == b"aa"
    with pytest.raises(OverflowError):
        encoded_number(2**31)


@given(VALUES)
def test_the_form_is_that_of_the_general_encoder(value: object) -> None:
    """But for doubles, which it shortens, and times, which it tags."""
    try:
        expected = cbor2.dumps(value, canonical=True)
    except (cbor2.CBOREncodeError, ValueError):
        return
    if b"\xc0" not in expected and not _has_float(value):
        assert encoded(value) == expected


def _has_float(value: object) -> bool:
    if isinstance(value, dict):
        return any(map(_has_float, value.values()))
    return isinstance(value, float | datetime) or (isinstance(value, list) and any(map(_has_float, value)))
