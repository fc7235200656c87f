"""Operators: parameters, the types they treat, and their results."""

import math
import struct
from typing import Any

import numpy as np
import pytest

from grants.errors import FilterRefused
from grants.filters.compile import compile_filter
from grants.filters.layout import PRIMITIVES, Array, Struct, Text
from grants.filters.operators import DESCEND, OPERATORS, Constant, Numbers, treatment_for
from grants.model import FilterRule, filter_rules
from tests.grants.messages import layout, text


def apply(fields: str, treated: dict[str, object], content: bytes) -> bytes:
    """The filter `treated` on field `x` of a message of `fields`."""
    return b"".join(compile_filter(layout(fields), filter_rules({"x": treated}))(content))


def u32(number: int) -> bytes:
    return number.to_bytes(4, "little")


def floats(*values: float) -> bytes:
    return struct.pack(f"<{len(values)}d", *values)


APPLIED: list[tuple[str, dict[str, object], bytes, bytes]] = [
    ("int32 x", {"clear": True}, b"1234", bytes(4)),
    ("string x", {"clear": True}, text("abc"), bytes(4)),
    ("int16[] x", {"clear": True}, u32(2) + b"1234", bytes(4)),
    ("string[2] x", {"clear": True}, text("a") + text("b"), bytes(8)),
    ("string[] x", {"drop": True}, u32(1) + text("a"), bytes(4)),
    ("int16[] x", {"zero": True}, u32(2) + b"1234", u32(2) + bytes(4)),
    ("int16[2] x", {"zero": True}, b"1234", bytes(4)),
    ("float64 x", {"round": {"step": 0.5}}, floats(1.3), floats(1.5)),
    ("time x", {"round": {"step": 60}}, u32(90) + u32(5), u32(120) + u32(0)),
    ("uint8 x", {"round": {"step": 10}}, b"\xff", b"\xfa"),
    ("float64 x", {"clamp": {"low": 0, "high": 1}}, floats(7), floats(1)),
    ("float64 x", {"clamp": {"low": 0, "high": 1}}, floats(-7), floats(0)),
    ("float64 x", {"clamp": {"low": 0, "high": 1}}, floats(math.nan), floats(0)),
    ("float64 x", {"clamp": {"low": 0, "high": 1}}, floats(0.25), floats(0.25)),
    (
        "float64[] x",
        {"clamp": {"low": -1.0, "high": math.inf}},
        u32(4) + floats(-7, 0.5, math.nan, math.inf),
        u32(4) + floats(-1, 0.5, -1, math.inf),
    ),
    ("uint8[] x", {"clamp": {"low": 3, "high": 9}}, u32(3) + b"\0\5\xff", u32(3) + b"\3\5\t"),
    ("int8 x", {"clamp": {"low": -3, "high": 9}}, b"\x80", b"\xfd"),
    ("int32 x", {"set": {"value": -2}}, b"1234", b"\xfe\xff\xff\xff"),
    ("float32 x", {"set": {"value": 1}}, b"1234", struct.pack("<f", 1)),
    ("bool x", {"set": {"value": True}}, b"\0", b"\1"),
    ("string x", {"set": {"value": "ß"}}, text("abc"), text("ß")),
    ("string x", {"redact": {"text": "***"}}, text("secret"), text("***")),
    ("string x", {"truncate": {"length": 2}}, text("ßäö"), text("ßä")),
    ("string x", {"truncate": {"length": 9}}, text("ßäö"), text("ßäö")),
    ("int16[] x", {"truncate": {"length": 1}}, u32(2) + b"1234", u32(1) + b"12"),
    ("int16[] x", {"truncate": {"length": 5}}, u32(2) + b"1234", u32(2) + b"1234"),
    ("int16[] x", {"truncate": {"length": 0}}, u32(2) + b"1234", u32(0)),
]


@pytest.mark.parametrize("number", range(len(APPLIED)))
def test_an_operator_applied_to_a_field(number: int) -> None:
    fields, treated, before, after = APPLIED[number]
    assert apply(fields, treated, before) == after
    # Between other fields, and large enough to be sliced without copies.
    tail = bytes(range(256)) * 10
    around = f"uint8 a\n{fields}\nuint8[2560] b"
    assert apply(around, treated, b"a" + before + tail) == b"a" + after + tail


def test_every_operator_is_tested_here() -> None:
    elsewhere = {"hash", "pixelate", "rooms", "sort"}  # each in a file of its own
    tried = {name for _, treated, _, _ in APPLIED for name in treated}
    assert tried | elsewhere == OPERATORS.keys()


def test_arrays_of_elements_without_bytes() -> None:
    shape = layout("E[] x", "MSG: t/E")
    for treated in ("zero", "clear", "drop"):
        compiled = compile_filter(shape, filter_rules({"x": {treated: True}}))
        assert b"".join(compiled(u32(7))) in (u32(0), u32(7))


INT, FLOAT, TEXT = PRIMITIVES["int8"], PRIMITIVES["float32"], Text()
REFUSED: list[tuple[str, dict[str, Any], Any, str]] = [
    ("clear", {"a": 1}, None, "x: expected no parameters, found a"),
    ("round", {}, None, "x: step must be a number"),
    ("round", {"step": "1"}, None, "step must be a number"),
    ("round", {"step": True}, None, "step must be a number"),
    ("round", {"step": math.nan}, None, "step must be a number"),
    ("round", {"step": 10**400}, None, "step is beyond 64 bits"),
    ("round", {"step": 0}, None, "step above zero"),
    ("round", {"step": -1.0}, None, "step above zero"),
    ("round", {"step": math.inf}, None, "step above zero"),
    ("round", {"step": 1, "more": 1}, None, "expected step, found more, step"),
    ("round", {"step": 0.5}, INT, "must be whole"),
    ("round", {"step": 1}, TEXT, "round needs numbers, not string"),
    ("clamp", {"low": 0}, None, "high must be a number"),
    ("clamp", {"low": 2, "high": 1}, None, "low <= high"),
    ("clamp", {"low": 0, "high": 200}, INT, "clamp cannot put 200 into int8"),
    ("clamp", {"low": 0.5, "high": 1}, INT, "clamp cannot put 0.5 into int8"),
    ("clamp", {"low": 0, "high": 1e300}, FLOAT, "clamp cannot put 1e.300 into float32"),
    ("clamp", {"low": 0, "high": 1}, TEXT, "clamp needs numbers"),
    ("clamp", {"low": 0, "high": 1}, PRIMITIVES["time"], "clamp needs numbers"),
    ("set", {}, None, "expected value, found none"),
    ("set", {"value": "a"}, INT, "set cannot put 'a' into int8"),
    ("set", {"value": True}, INT, "set cannot put True into int8"),
    ("set", {"value": 1}, PRIMITIVES["bool"], "set cannot put 1 into bool"),
    ("set", {"value": 1}, TEXT, "set cannot put 1 into string"),
    ("set", {"value": 1}, PRIMITIVES["time"], "set cannot put 1 into time"),
    ("set", {"value": 1}, Array(INT, None), "set cannot put 1 into int8"),
    ("redact", {}, None, "expected text, found none"),
    ("redact", {"text": 1}, None, "redact needs a text"),
    ("redact", {"text": "x"}, INT, "redact needs a string, not int8"),
    ("truncate", {"length": 1.5}, None, "non-negative whole length"),
    ("truncate", {"length": -1}, None, "non-negative whole length"),
    ("truncate", {"length": 1}, INT, "truncate needs a string or an array"),
    ("truncate", {"length": 1}, Array(INT, 3), "truncate needs a string or an array"),
    ("drop", {}, Array(INT, 3), "array of variable length"),
    ("drop", {}, TEXT, "array of variable length"),
    ("zero", {}, INT, "array of fixed-size elements"),
    ("zero", {}, Array(TEXT, None), "array of fixed-size elements"),
    ("round", {"step": 1, "hysteresis": 0}, None, "above zero and at most the step"),
    ("round", {"step": 1, "hysteresis": 1.5}, None, "above zero and at most the step"),
    ("round", {"step": 1, "hysteresis": "1"}, None, "hysteresis must be a number"),
    ("round", {"step": 1, "hysteresis": 1}, PRIMITIVES["time"], "needs numbers, not time"),
    ("round", {"step": 1, "hysteresis": 1}, TEXT, "round needs numbers, not string"),
    ("hash", {}, None, "expected key, found none"),
    ("hash", {"key": "Ward"}, None, "not a key name"),
    ("hash", {"key": "../x"}, None, "not a key name"),
    ("hash", {"key": "a", "length": 0}, None, "length must be a whole number from 1 to 64"),
    ("hash", {"key": "a", "length": 65}, None, "length must be a whole number from 1 to 64"),
    ("hash", {"key": "a", "per": "node"}, None, "per is receiver"),
    ("hash", {"key": "a", "per": True}, None, "per is receiver"),
    ("pixelate", {"block": 2, "levels": 1}, None, "levels must be a whole number from 2 to 256"),
    ("pixelate", {"block": 2, "levels": 257}, None, "levels must be a whole number from 2"),
    ("pixelate", {"block": 2, "levels": 8.0}, None, "levels must be a whole number from 2"),
    ("rooms", {}, None, "1 to 64 rooms"),
    ("sort", {"by": "name"}, None, "expected no parameters, found by"),
    ("hash", {"key": "a", "more": 1}, None, "expected key, found key, more"),
    ("hash", {"key": "a"}, INT, "hash needs a string, not int8"),
    ("pixelate", {}, None, "block must be a whole number"),
    ("pixelate", {"block": 1}, None, "from 2 to 65535"),
    ("pixelate", {"across": 0}, None, "across must be a whole number from 1 to 65535"),
    ("pixelate", {"across": 65536}, None, "across must be a whole number from 1 to 65535"),
    ("pixelate", {"across": 16.0}, None, "across must be a whole number"),
    ("pixelate", {"across": True}, None, "across must be a whole number"),
    ("pixelate", {"across": "16"}, None, "across must be a whole number"),
    ("pixelate", {"across": 16, "block": 1}, None, "from 2 to 65535"),
    ("pixelate", {"across": 16, "block": None}, None, "block must be a whole number"),
    ("pixelate", {"across": 16, "down": 9}, None, "expected across, found across, down"),
    ("pixelate", {"block": 4.0}, None, "block must be a whole number from 2 to 65535"),
    ("pixelate", {"block": True}, None, "block must be a whole number"),
    ("pixelate", {"block": 4, "x": 1}, None, "y must be a whole number from 0"),
    ("pixelate", {"block": 4, "z": 1}, None, "expected block, found block, z"),
    ("pixelate", {"block": 4}, Array(INT, None), "needs the data of a sensor_msgs/Image"),
    ("cleer", {}, None, "unknown operator 'cleer'"),
]


@pytest.mark.parametrize("number", range(len(REFUSED)))
def test_unsuitable_types_and_parameters_are_refused(number: int) -> None:
    operator, parameters, kind, message = REFUSED[number]
    with pytest.raises(FilterRefused, match=message):
        treatment_for(FilterRule("x", operator, tuple(sorted(parameters.items()))))(kind)


def test_unknown_operators_have_a_hint() -> None:
    for operator, hint in (("cleer", "did you mean 'clear'?"), ("?", "expected one of clear, round")):
        with pytest.raises(FilterRefused) as refused:
            treatment_for(FilterRule("x", operator))
        assert refused.value.hint.startswith(hint)


def test_operators_return_treatments() -> None:
    clear = treatment_for(FilterRule("x", "clear"))
    point = Struct("t/P", (("x", INT), ("s", TEXT)))
    assert clear(point) == DESCEND
    assert clear(Array(point, 2)) == DESCEND
    assert clear(Array(point, None)) == Constant(bytes(4))
    clamp = treatment_for(FilterRule("x", "clamp", (("high", 5), ("low", 1))))
    assert clamp(point) == DESCEND
    numbers = clamp(PRIMITIVES["uint64"])
    assert isinstance(numbers, Numbers)
    values = np.array([0, 3, 2**64 - 1], "<u8")
    assert [numbers.scalar(int(v)) for v in values] == numbers.vector(values).tolist() == [1, 3, 5]
