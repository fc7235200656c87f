"""Values of every other type in every place of a valid structure: well-formed, invalid CBOR.

Random bytes fail at the first check of form. Here the form is valid and one item is not:
each part is replaced by a value of every type, left out, doubled, or put under another key. Byte
strings that hold CBOR are changed inside as well.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import cbor2

from ca.encoding import decode
from ca.errors import EncodingError


@dataclass(frozen=True)
class Raw:
    """Bytes that are encoded as they are."""

    data: bytes

    def __hash__(self) -> int:
        return hash(self.data)


def nested(depth: int) -> Raw:
    """Arrays in arrays."""
    return Raw(b"\x81" * depth + b"\x80")


STRANGE: Final[tuple[Any, ...]] = (
    0,
    1,
    -1,
    24,
    1 << 31,
    1 << 53,
    (1 << 63) - 1,
    (1 << 64) - 1,
    -(1 << 64),
    0.0,
    0.5,
    -1.5,
    1e300,
    float("inf"),
    float("-inf"),
    b"",
    b"\0",
    bytes(16),
    bytes(32),
    b"\x80",
    b"\xa0",
    bytes(300),
    "",
    "x",
    "/x",
    "/**",
    "a.b",
    "\0",
    "\x1b[31m",
    "\u202e",
    "\ud7ff\U0010ffff",
    "x" * 2000,
    "1e400",
    True,
    False,
    None,
    [],
    [0],
    [None],
    ["x", "y"],
    [[[]]],
    [b"", "", 0, {}],
    {},
    {0: 0},
    {"x": "y"},
    {"x": {"y": True}},
    {-1: [], "": {}},
    nested(10),
    nested(40),
    nested(3000),
    Raw(b"\xc2\x49" + b"\1" + bytes(8)),  # 2^64, a bignum
    Raw(b"\xc1\x1a" + bytes(4)),
    Raw(b"\xd8\x23\x61("),
    Raw(b"\xd9\xd9\xf7\0"),  # tags: a time,
    Raw(b"\xd8\x18\x41\0"),
    Raw(b"\xf7"),
    Raw(b"\xe0"),
    Raw(b"\xf8\xff"),  # a pattern, undefined
    Raw(b"\xf9\x7e\0"),
    Raw(b"\xfb" + struct.pack(">d", float("nan"))),  # NaN
    Raw(b"\x9f\xff"),
    Raw(b"\x7f\xff"),
    Raw(b"\xbf\xff"),  # without a length
    Raw(b"\x5b" + b"\xff" * 8),
    Raw(b"\x9b" + b"\x7f" * 8),
    Raw(b"\xbb" + b"\x7f" * 8),  # too long
    Raw(b"\x18\0"),
    Raw(b"\x62\xc3\x28"),
    Raw(b"\x63\xed\xa0\x80"),
    Raw(b"\xa2\0\0\0\0"),
    Raw(b"\xa1\x80\0"),
    Raw(b"\xa1\xa0\0"),
    Raw(b"\xa1\xf4\0"),
    Raw(b"\xff"),
    Raw(b""),
)
KEYS: Final[tuple[Any, ...]] = (0, -1, 1 << 60, "", "rate", True, None, b"k", 0.5, Raw(b"\x80"))


def dumps(value: Any) -> bytes:
    """CBOR with `Raw` as it is; maps in canonical order."""
    match value:
        case Raw(data):
            return data
        case list():
            return cbor_head(0x80, len(value)) + b"".join(map(dumps, value))
        case dict():
            pairs = sorted((dumps(key), dumps(item)) for key, item in value.items())
            pairs.sort(key=lambda pair: (len(pair[0]), pair[0]))
            return cbor_head(0xA0, len(pairs)) + b"".join(key + item for key, item in pairs)
        case _:
            return cbor2.dumps(value, canonical=True)


def cbor_head(major: int, count: int) -> bytes:
    """Of a container with fewer than 65536 members."""
    if count < 24:
        return bytes((major | count,))
    return bytes((major | 25,)) + count.to_bytes(2)


def mutants(value: Any) -> Iterator[Any]:
    """`value` with one item changed, in every way; unchanged as the last."""
    yield from _changed(value)
    yield value


def _changed(value: Any) -> Iterator[Any]:
    yield from STRANGE
    match value:
        case list():
            yield from _lists(value)
        case dict():
            yield from _maps(value)
        case bytes() if (inner := _inside(value)) is not None:
            for changed in _changed(inner):
                yield dumps(changed)


def _lists(value: list[Any]) -> Iterator[list[Any]]:
    for place, item in enumerate(value):
        before, after = value[:place], value[place + 1 :]
        yield before + after
        yield [*before, item, item, *after]
        for changed in _changed(item):
            yield [*before, changed, *after]
    yield [*value, None]
    yield value[::-1]


def _maps(value: dict[Any, Any]) -> Iterator[dict[Any, Any]]:
    for key, item in value.items():
        rest = {other: content for other, content in value.items() if other != key}
        yield rest
        for other in KEYS:
            yield {**rest, other: item}
            yield {**value, other: item}
        for changed in _changed(item):
            yield {**rest, key: changed}


def _inside(data: bytes) -> Any:
    """The list or map that a byte string holds, if it does."""
    try:
        value = decode(data)
    except EncodingError:
        return None
    return value if isinstance(value, list | dict) and value else None
