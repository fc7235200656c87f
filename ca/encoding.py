"""Strict deterministic CBOR (RFC 8949): one value, one encoding, nothing else accepted.

`cbor2` decodes; the strictness is here. A value is accepted only if encoding it again gives the
very bytes that came in, which refuses in one comparison long integers, long floats, unsorted
maps and trailing bytes. Map keys are sorted length-first (RFC 8949 section 4.2.3), floats take
their shortest form. Tags are refused before `cbor2` interprets them (its decoder of tag 35 would
compile an attacker's regular expression).
"""

import math
from io import BytesIO
from typing import Final, NoReturn, TypeAlias

import cbor2

from ca.errors import EncodingError

Value: TypeAlias = "int | float | str | bytes | bool | list[Value] | dict[int | str, Value] | None"

MAX_SIZE: Final = 16 * 1024
MAX_DEPTH: Final = 16
_INT_LIMIT: Final = 1 << 64  # beyond it cbor2 writes a bignum, which is a tag

# The tags cbor2 6 decodes by itself; every other one reaches `tag_hook`.
_BUILT_IN_TAGS: Final = (
    *range(6), 25, 28, 29, 30, 35, 36, 37, 52, 54,
    100, 256, 258, 260, 261, 1004, 43000, 55799,
)  # fmt: skip


def encode(value: Value) -> bytes:
    """Encode `value` in its one deterministic form.

    Raises:
        EncodingError: the value holds a type, number or key outside the subset.
    """
    _check(value, MAX_DEPTH)
    return cbor2.dumps(value, canonical=True)


def decode(data: bytes, *, limit: int = MAX_SIZE) -> Value:
    """Decode exactly one value that fills `data`; `limit` is checked before anything is parsed.

    Raises:
        EncodingError: too long, malformed, not deterministic, or outside the subset.
    """
    items = decode_sequence(data, limit=limit)
    if len(items) != 1:
        raise EncodingError(f"expected one CBOR item, found {len(items)}")
    return items[0]


def decode_sequence(data: bytes, *, limit: int = MAX_SIZE) -> list[Value]:
    """Decode a CBOR sequence (RFC 8742) that fills `data`; the empty sequence is allowed.

    Raises:
        EncodingError: as for `decode`.
    """
    if len(data) > limit:
        raise EncodingError(f"{len(data)} bytes of CBOR where at most {limit} are allowed")
    items: list[Value] = []
    stream = BytesIO(data)
    while stream.tell() < len(data):
        items.append(_decode_item(stream))
    if b"".join(map(encode, items)) != data:
        raise EncodingError("CBOR that is not in its deterministic form")
    return items


def _decode_item(stream: BytesIO) -> Value:
    decoder = cbor2.CBORDecoder(
        stream,
        tag_hook=_refuse_tag,
        semantic_decoders=dict.fromkeys(_BUILT_IN_TAGS, _refuse_tag),
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


def _check(value: object, depth: int) -> None:
    """Raise unless `value` lies in the subset: `encode` and `decode` share this one gate."""
    if depth < 0:
        raise EncodingError(f"CBOR nested deeper than {MAX_DEPTH}")
    if isinstance(value, list):
        for item in value:
            _check(item, depth - 1)
    elif isinstance(value, dict):
        for key, item in value.items():
            if isinstance(key, bool) or not isinstance(key, int | str):
                raise EncodingError("map key that is neither integer nor text")
            _check_leaf(key)
            _check(item, depth - 1)
    else:
        _check_leaf(value)


def _check_leaf(value: object) -> None:
    if not isinstance(value, bool | int | float | str | bytes | None):
        raise EncodingError(f"{type(value).__name__} is not in rossec's CBOR subset")
    if isinstance(value, int) and not -_INT_LIMIT <= value < _INT_LIMIT:
        raise EncodingError("integer beyond 64 bits")
    # NaN has many encodings and no meaning in anything we sign.
    if isinstance(value, float) and math.isnan(value):
        raise EncodingError("NaN has no deterministic encoding")
