"""Strict deterministic CBOR (RFC 8949): one value, one encoding, nothing else accepted.

`cbor2` decodes; the strict checks are here. Map keys are sorted length-first (RFC 8949 section 4.2.3),
floats take their shortest form.
"""

import math
from collections.abc import Iterable
from io import BytesIO
from typing import Any, Final, NoReturn, TypeAlias, TypeGuard

import cbor2

from ca.errors import EncodingError

Value: TypeAlias = "int | float | str | bytes | bool | list[Value] | dict[int | str, Value] | None"

MAX_SIZE: Final = 16 * 1024
MAX_DEPTH: Final = 16
NUMBER_LIMIT: Final = 1 << 53  # of the numbers in statements: exact also where numbers are floats
_INT_LIMIT: Final = 1 << 64  # from here on cbor2 writes a bignum, which is a tag
_PLAIN: Final = frozenset({str, bytes, bool, type(None)})  # these need no check
# Tuples, made once: `isinstance` with a union costs three times as much.
_CONTAINERS: Final = (list, dict)
_KEYS: Final = (int, str)
_LEAVES: Final = (str, bytes, float, type(None))

# By the bytes an integer needs: additional information, and the bytes it is encoded in.
_HEADS: Final = ((24, 1), (24, 1), (25, 2), *2 * ((26, 4),), *4 * ((27, 8),))

# Tags are refused before `cbor2` interprets them: its decoder of tag 35 would compile an attacker's regular
# expression. The tags cbor2 6 decodes by itself; every other one reaches `tag_hook`.
_TAGS: Final = (*range(6), 25, 28, 29, 30, 35, 36, 37, 52, 54, 100, 256, 258, 260, 261, 1004, 43000, 55799)


def is_number(value: object) -> TypeGuard[int]:
    """Whether `value` may be a number of a statement: no boolean, not negative, below 2^53."""
    return type(value) is int and 0 <= value < NUMBER_LIMIT


def encode(value: Value) -> bytes:
    _check(value, MAX_DEPTH)
    return cbor2.dumps(value, canonical=True)


def decode(data: bytes, *, limit: int = MAX_SIZE) -> Value:
    """Decode exactly one value that fills `data`; `limit` is checked before parsing."""
    items = decode_sequence(data, limit=limit)
    if len(items) != 1:
        raise EncodingError(f"expected one CBOR item, found {len(items)}")
    return items[0]


def parse(data: bytes) -> Value:
    """Decode one value *without* checking that its form is deterministic."""
    # Only for callers that encode the value again and compare it with all of `data`; tags, duplicate keys and
    # indefinite lengths are refused here too, and the caller has limited the size of `data`.
    return _decode_item(BytesIO(data))


def head(major: int, value: int) -> bytes:
    """The deterministic head of an item (RFC 8949 section 3): `major` is its type shifted left."""
    if 0 <= value < 24:
        return bytes((major | value,))
    if not 0 <= value < _INT_LIMIT:
        raise EncodingError("integer beyond 64 bits")
    info, size = _HEADS[value.bit_length() + 7 >> 3]
    return bytes((major | info,)) + value.to_bytes(size)


def decode_sequence(data: bytes, *, limit: int = MAX_SIZE) -> list[Value]:
    """Decode a CBOR sequence (RFC 8742) that fills `data`; the empty sequence is allowed."""
    if len(data) > limit:
        raise EncodingError(f"{len(data)} bytes of CBOR where at most {limit} are allowed")
    items: list[Value] = []
    stream = BytesIO(data)
    while stream.tell() < len(data):
        items.append(_decode_item(stream))
    # One value, one encoding: else two readers could see two statements in what one key signed.
    if b"".join(map(encode, items)) != data:
        raise EncodingError("CBOR that is not in its deterministic form")
    return items


def _decode_item(stream: BytesIO) -> Value:
    decoder = cbor2.CBORDecoder(
        stream,
        tag_hook=_refuse_tag,
        semantic_decoders=_REFUSED_TAGS,
        max_depth=MAX_DEPTH,
        allow_indefinite=False,
        allow_duplicate_keys=False,
    )
    try:
        value: Value = decoder.decode()
    except (cbor2.CBORDecodeError, ValueError, TypeError, OverflowError) as error:
        raise EncodingError("malformed CBOR") from error
    return value


def _refuse_tag(*_: object) -> NoReturn:
    raise ValueError("tags are outside the subset")


_REFUSED_TAGS: Final = dict.fromkeys(_TAGS, _refuse_tag)


def _check(value: Any, depth: int) -> None:
    # Raise unless `value` is in the subset: `encode` and `decode` share this check.
    # Exact classes are checked first: nearly every value has one, and the check is cheap.
    if not isinstance(value, _CONTAINERS):
        _check_leaf(value)
        return
    if depth == 0 and len(value) > 0:
        raise EncodingError(f"CBOR nested deeper than {MAX_DEPTH}")
    items: Iterable[Any] = value
    if isinstance(value, dict):
        items = value.values()
        for key in value:
            if type(key) is not str:
                if isinstance(key, bool) or not isinstance(key, _KEYS):
                    raise EncodingError("map key that is neither integer nor text")
                _check_leaf(key)
    for item in items:
        if type(item) not in _PLAIN:
            _check(item, depth - 1)


def _check_leaf(value: object) -> None:
    if isinstance(value, int):
        if not -_INT_LIMIT <= value < _INT_LIMIT:
            raise EncodingError("integer beyond 64 bits")
    elif not isinstance(value, _LEAVES):
        raise EncodingError(f"{type(value).__name__} is not in rossec's CBOR subset")
    elif isinstance(value, float) and math.isnan(value):
        # NaN has many encodings and no meaning in anything we sign.
        raise EncodingError("NaN has no deterministic encoding")
