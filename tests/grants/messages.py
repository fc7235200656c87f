"""Small definitions for tests without ROS, and random messages for tests with it."""

import importlib
import random  # noqa: TID251 - seeded, for reproducible failures
import struct
from io import BytesIO
from typing import Any

from grants.filters.layout import Layout, parse

SEPARATOR = "=" * 80
EVERYTHING = f"""# every kind of field
uint8 DEBUG=1
string NAME = a # b
Header header
bool flag
int8 i8
uint64 u64
int64 i64
float32 f32
float64 f64
time stamp
duration lasted
string text
Point point
Point[] points
Point[2] corners
float32[] ranges
float64[3] three
float64[36] covariance
uint8[] data
int64[] longs
time[] times
string[] names
Named[] named
Named[2] pair
{SEPARATOR}
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
{SEPARATOR}
MSG: test_msgs/Point
float64 x
float64 y
float64 z
{SEPARATOR}
MSG: test_msgs/Named
string name
Point[] path
test_msgs/Point at
"""
LAYOUT = parse("test_msgs/Everything", EVERYTHING)


def seeded_random(seed: int) -> random.Random:
    return random.Random(seed)


def text(value: str) -> bytes:
    data = value.encode()
    return struct.pack("<I", len(data)) + data


def layout(fields: str, *more: str) -> Layout:
    """A layout of type `t/T` with these fields, and further sections."""
    return parse("t/T", "\n".join([fields, *(f"{SEPARATOR}\n{section}" for section in more)]))


SPECIAL = [float("nan"), float("inf"), float("-inf"), -0.0, 0.0, 0.25, -0.25, 1e30, -1e300, 5e-324]


def serialized(message: Any) -> bytes:
    buffer = BytesIO()
    message.serialize(buffer)
    return buffer.getvalue()


def random_value(kind: str, rng: random.Random) -> Any:
    """A random value of a built-in type of genpy."""
    import genpy

    if kind in ("float32", "float64"):
        value = rng.choice([rng.uniform(-100, 100), rng.choice(SPECIAL)])
        small = kind == "float32" and abs(value) > 3e38 and value not in SPECIAL[:3]
        return 1.5 if small else value
    if kind == "string":
        return "".join(rng.choice("aß语🤖 \n") for _ in range(rng.randrange(6)))
    if kind == "time":
        return genpy.Time(rng.getrandbits(32), rng.randrange(10**9))
    if kind == "duration":
        return genpy.Duration(rng.getrandbits(32) - (1 << 31), rng.randrange(10**9))
    if kind == "bool":
        return rng.random() < 0.5
    bits = {"char": 8, "byte": 8}.get(kind) or int(kind.lstrip("uint"))
    signed = not kind.startswith("u") and kind != "char"
    return rng.getrandbits(bits) - ((1 << bits - 1) if signed else 0)


def fill(message: Any, rng: random.Random) -> Any:
    """Fill a genpy message with random values, in place."""
    roslib, genmsg = map(importlib.import_module, ("roslib.message", "genmsg.msgs"))
    for name, kind in zip(message.__slots__, message._slot_types, strict=True):
        base, is_array, length = genmsg.parse_type(kind)

        def one(base: str = base) -> Any:
            if genmsg.is_builtin(base):
                return random_value(base, rng)
            made = roslib.get_message_class(base)
            return fill(made(), rng)

        if not is_array:
            setattr(message, name, one())
            continue
        count = rng.randrange(5) if length is None else length
        values = [one() for _ in range(count)]
        setattr(message, name, bytes(values) if base in ("uint8", "char") else values)
    return message
