"""The values of parameters: which there can be, and how much room they take. Pure.

Whatever is taken in must be good to be handed out again, written to the journal and told to
subscribers. XML-RPC has extensions (nil, long and big numbers) that a call can bring but no answer
can carry: one such value would spoil every tree that holds it. Sizes are about those of the answer.
"""

from collections.abc import Iterator
from datetime import datetime
from itertools import accumulate
from typing import Final, NoReturn

from rossec.ros import names
from rossec.ros.xmlwrite import EncodedList

DEPTH_LIMIT: Final = 32
_INTS: Final = range(-(2**31), 2**31)
_SCALAR, _TEXT, _ARRAY, _STRUCT, _MEMBER = 28, 36, 52, 46, 34  # bytes around the text of each
_SCALARS: Final = (bool, float, datetime)
Tree = dict[str, object]


def check(value: object, depth: int = DEPTH_LIMIT) -> None:
    """Return if `value` can be a parameter, or a tree of them, of at most `depth` levels.

    Raises:
        ValueError: it is too deep, a name in it is not one segment, or no answer can carry it.
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
    """Whether it can be the name of a parameter; XML lets a number stand in its place."""
    if not isinstance(name, str) or not name or name.startswith(names.PRIVATE):
        return False
    return names.SEPARATOR not in name


def weight(value: object) -> int:
    """About how many bytes `value` takes in an answer; anything that a method answers."""
    match value:
        case EncodedList():
            return len(value.text)
        case str() | bytes():
            return _TEXT + len(value)
        case dict():
            return _STRUCT + sum(entry_weight(name, below) for name, below in value.items())
        case list() | tuple():
            return _ARRAY + sum(map(weight, value))
        case _:
            return _SCALAR


def exceeds(value: object, limit: int) -> bool:
    """Whether the `weight` of a parameter is more than `limit`; not weighed much further."""
    return any(limit < so_far for so_far in accumulate(_weights(value)))


def entry_weight(name: str, value: object) -> int:
    """About how many bytes a member of a struct takes."""
    return _MEMBER + len(name) + weight(value)


def _weights(value: object) -> Iterator[int]:
    """The parts of `weight`, a namespace entry by entry."""
    if not isinstance(value, dict):
        yield weight(value)
        return
    yield _STRUCT
    for name, below in value.items():
        yield _MEMBER + len(name)
        yield from _weights(below)


def _check_scalar(value: object) -> None:
    if type(value) is int:
        if value not in _INTS:
            _refuse(f"the number {value}" if abs(value) < 1 << 70 else "so long a number")
    elif type(value) not in _SCALARS:
        _refuse("no value" if value is None else f"a {type(value).__name__}")


def _refuse(what: str) -> NoReturn:
    raise ValueError(f"XML-RPC cannot carry {what} to those who ask for it")
