"""The values of parameters: which are valid, and about how many bytes they take. Pure.

Every accepted value must be encodable: in answers, in the journal and in updates to subscribers.
XML-RPC has extensions (nil, long and big numbers) that a call can carry but no answer can: one such
value would make every tree that contains it unreadable. Sizes approximate those of the answer.
"""

from collections.abc import Collection, Iterator
from datetime import datetime
from itertools import accumulate
from typing import Any, Final, NoReturn

from rossec.ros import names
from rossec.ros.xmlwrite import EncodedList

DEPTH_LIMIT: Final = 32
_INTS: Final = range(-(2**31), 2**31)
_SCALAR, _TEXT, _ARRAY, _STRUCT, _MEMBER = 28, 36, 52, 46, 34  # bytes of markup of each
_SCALARS: Final = (bool, float, datetime)
_FLAT: Final = frozenset({int, *_SCALARS})
Tree = dict[str, object]


def check(value: object, depth: int = DEPTH_LIMIT) -> None:
    """Check that `value` is a valid parameter, or a tree of them, of at most `depth` levels.

    Raises:
        ValueError: it is too deep, a name in it is not one segment, or XML-RPC cannot encode it.
    """
    if depth < 0:
        raise ValueError(f"parameters nested deeper than {DEPTH_LIMIT}")
    if isinstance(value, dict):
        for name, below in value.items():
            if not _is_segment(name):
                raise ValueError(f"{name!r} cannot be the name of a parameter in a tree")
            check(below, depth - 1)
    elif isinstance(value, list):
        for item in value:
            check(item, depth - 1)
    elif not isinstance(value, str | bytes):
        _check_scalar(value)


def _is_segment(name: object) -> bool:
    """Whether `name` is a valid key in a tree; XML-RPC also allows numbers as keys."""
    if not isinstance(name, str) or not name or name.startswith(names.PRIVATE):
        return False
    return names.SEPARATOR not in name


def encoded_size(value: object) -> int:
    """About how many bytes `value` takes in an answer; for any value that a method returns."""
    match value:
        case EncodedList():
            return len(value.text)
        case str() | bytes():
            return _TEXT + len(value)
        case dict():
            return _STRUCT + _MEMBER * len(value) + sum(map(len, value)) + _sizes(value.values())
        case list() | tuple():
            return _ARRAY + _sizes(value)
        case _:
            return _SCALAR


def exceeds(value: object, limit: int) -> bool:
    """Whether the `encoded_size` of a parameter exceeds `limit`; stops soon after it does."""
    return any(limit < so_far for so_far in accumulate(_encoded_sizes(value)))


def member_size(name: str, value: object) -> int:
    """About how many bytes one member of a struct takes."""
    return _MEMBER + len(name) + encoded_size(value)


def _encoded_sizes(value: object) -> Iterator[int]:
    """The summands of `encoded_size`, those of a namespace member by member."""
    if not isinstance(value, dict):
        yield encoded_size(value)
        return
    yield _STRUCT + _MEMBER * len(value) + sum(map(len, value))
    if _flat_size(value.values()) is not None:
        yield _sizes(value.values())
        return
    for below in value.values():
        yield from _encoded_sizes(below)


def _sizes(values: Collection[Any]) -> int:
    flat = _flat_size(values)
    return sum(map(encoded_size, values)) if flat is None else flat


def _flat_size(values: Collection[Any]) -> int | None:
    """The size of values of one kind, without a look at each in Python; None: of several kinds."""
    kinds = set(map(type, values))
    if kinds <= _FLAT:
        return _SCALAR * len(values)
    return _TEXT * len(values) + sum(map(len, values)) if kinds == {str} else None


def _check_scalar(value: object) -> None:
    if type(value) is int:
        if value not in _INTS:
            _refuse(f"the number {value}" if abs(value) < 1 << 70 else "a number this long")
    elif type(value) not in _SCALARS:
        _refuse("nil" if value is None else f"a {type(value).__name__}")


def _refuse(what: str) -> NoReturn:
    raise ValueError(f"XML-RPC cannot carry {what} in an answer")
