"""Named tuples as CBOR values and back: what the console and the service send each other. Pure.

A record is the list of its fields. The annotations say what may come: int, str, bytes, bool, one of
them or None, a tuple of any number of them, another record. Everything else is refused, also an int
where a bool belongs, so the reader of a record needs no further check of types.
"""

from types import NoneType, UnionType
from typing import Any, Final, TypeVar, get_args, get_origin, get_type_hints

from ca.encoding import Value
from rossec.errors import KeyMessageRefused

_PLAIN: Final = (int, str, bytes, bool)
_HINT: Final = "are the service and the console of one version of rossec?"
_T = TypeVar("_T")


def to_value(item: object) -> Value:
    """The value of a record, of a tuple of records, or of a plain item."""
    if isinstance(item, tuple):
        return [to_value(each) for each in item]
    if item is None or type(item) in _PLAIN:
        return item  # type: ignore[return-value]
    raise TypeError(f"{type(item).__name__} is not part of a record")


def from_value(kind: type[_T], value: Value) -> _T:
    """The record of type `kind` that `value` is.

    Raises:
        KeyMessageRefused: another number of fields, or a field of another type.
    """
    found: _T = _read(kind, value)
    return found


def many(kind: type[_T], value: Value) -> tuple[_T, ...]:
    """As `from_value`, for a list of records."""
    if not isinstance(value, list):
        raise KeyMessageRefused("records that are no list", _HINT)
    return tuple(from_value(kind, each) for each in value)


def _read(kind: Any, value: Value) -> Any:
    if kind in _PLAIN or kind is NoneType:
        if type(value) is not kind:
            raise KeyMessageRefused(f"{type(value).__name__} where {kind.__name__} belongs", _HINT)
        return value
    if isinstance(kind, UnionType):
        possible = [each for each in get_args(kind) if each is not NoneType]
        return None if value is None else _read(possible[0], value)
    if not isinstance(value, list):
        raise KeyMessageRefused("a record that is no list", _HINT)
    if get_origin(kind) is tuple:
        return tuple(_read(get_args(kind)[0], each) for each in value)
    fields = get_type_hints(kind)
    if len(value) != len(fields):
        raise KeyMessageRefused(f"{kind.__name__} of {len(value)} fields", _HINT)
    return kind(*map(_read, fields.values(), value))
