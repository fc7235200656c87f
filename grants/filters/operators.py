"""The operators of filters: one entry in `OPERATORS` each.

An operator reads its named parameters and returns a function from the type of a field to a
treatment: a constant in its place, a function of its numbers, or a function of its bytes. An
operator that does not treat a type itself returns `DESCEND`, and is then applied to a message's
fields or an array's elements. Nothing here is source text: generated code only *calls* it.
"""

import difflib
import math
import struct
from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeAlias

from grants.errors import FilterRefused
from grants.filters.codegen import Buffer
from grants.filters.hashing import DEFAULT_LENGTH, RECEIVER, Keys, pseudonyms
from grants.filters.layout import PRIMITIVES, Array, Primitive, Struct, Text, Type
from grants.filters.lazy_numpy import Vector, np
from grants.filters.parameters import Parameters, expect, integer, number
from grants.filters.pictures import MAX_SIDE, SIBLINGS, pixelation
from grants.filters.positions import rooms
from grants.filters.rounding import round_floats, round_integers, round_times, with_hysteresis
from grants.filters.sorting import sorting
from grants.filters.treatments import (
    DESCEND,
    Constant,
    ContentTreatment,
    HysteresisBinding,
    Numbers,
    SiblingTreatment,
    Treatment,
    TreatmentForType,
)
from grants.model import FilterRule, Scalar

_EMPTY: Final = Constant(bytes(4))
_INTEGERS: Final = frozenset("bBhHiIqQ")


def _clear(parameters: Parameters) -> TreatmentForType:
    """The zero value: 0, false, "", no elements; a fixed array keeps its length."""
    expect(parameters)
    return _zero_value


def _zero_value(kind: Type) -> Treatment:
    if kind.size is not None:
        return Constant(bytes(kind.size))
    variable = isinstance(kind, Text) or (isinstance(kind, Array) and kind.length is None)
    return _EMPTY if variable else DESCEND


def _drop(parameters: Parameters) -> TreatmentForType:
    """No elements."""
    expect(parameters)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array) and kind.length is None:
            return _EMPTY
        raise FilterRefused(f"drop needs an array of variable length, not {kind.name}")

    return treat


def _zero(parameters: Parameters) -> TreatmentForType:
    """Zeros in place of the elements; the length stays, so images remain consistent."""
    expect(parameters)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Struct) and kind.size == 0:
            return Constant(b"")  # an element without bytes: the count of such an array stays
        if isinstance(kind, Array) and kind.element.size == 0:
            return DESCEND
        if not isinstance(kind, Array) or kind.element.size is None:
            raise FilterRefused(f"zero needs an array of fixed-size elements, not {kind.name}")
        if kind.size is not None:
            return Constant(bytes(kind.size))
        size = kind.element.size
        return ContentTreatment(lambda content: (bytes(len(content)), len(content) // size))

    return treat


def _round(parameters: Parameters) -> TreatmentForType:
    """To multiples of `step` (seconds for times): floor(x / step + 1/2) * step; NaN, inf pass.

    With `hysteresis` a value keeps its cell until it is that far beyond the border.
    """
    step = number(parameters, "step")
    hysteresis = number(parameters, "hysteresis") if "hysteresis" in parameters else None
    expect(parameters, "step", *(["hysteresis"] if hysteresis is not None else []))
    if not 0 < step < math.inf:
        raise FilterRefused("round needs a step above zero", "for example {round: {step: 0.5}}")
    if hysteresis is not None and not 0 < hysteresis <= step:
        raise FilterRefused("hysteresis must be above zero and at most the step")

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array | Struct):
            return DESCEND
        found = _rounding(kind, step)
        if hysteresis is None:
            return found
        if len(kind.code if isinstance(kind, Primitive) else "") > 1:
            raise FilterRefused(f"hysteresis needs numbers, not {kind.name}")
        binding = with_hysteresis(found.scalar, step, hysteresis)
        return replace(found, hysteresis=HysteresisBinding((step, hysteresis), binding))

    return treat


def _rounding(kind: Primitive | Text, step: float) -> Numbers:
    if isinstance(kind, Text) or kind.name == "bool":
        raise FilterRefused(f"round needs numbers, not {kind.name}")
    if kind.name in ("time", "duration"):
        return Numbers(*round_times(kind, step))
    if kind.code in _INTEGERS:
        return Numbers(*round_integers(kind, step))
    return Numbers(*round_floats(kind, step))


def _clamp(parameters: Parameters) -> TreatmentForType:
    """Into [low, high]; NaN becomes low."""
    low, high = number(parameters, "low"), number(parameters, "high")
    expect(parameters, "low", "high")
    if not low <= high:
        raise FilterRefused("clamp needs low <= high")

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array | Struct):
            return DESCEND
        if isinstance(kind, Text) or kind.name in ("bool", "time", "duration"):
            raise FilterRefused(f"clamp needs numbers, not {kind.name}")
        _pack(kind, low, "clamp")
        _pack(kind, high, "clamp")
        return _clamping(low, high)

    return treat


def _clamping(low: float, high: float) -> Numbers:
    def scalar(value: float) -> float:
        # Compared in this order NaN becomes `low`.
        return min(value, high) if value >= low else low

    def vector(values: Vector) -> Vector:
        return np.where(values >= low, np.where(values > high, high, values), low)

    return Numbers(scalar, vector)


def _set(parameters: Parameters) -> TreatmentForType:
    """Replace the value by this one."""
    value = parameters.get("value")
    expect(parameters, "value")

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Text) and isinstance(value, str):
            return Constant(_serialized_text(value))
        if isinstance(kind, Primitive) and len(kind.code) == 1:
            return Constant(_pack(kind, value, "set"))
        raise FilterRefused(f"set cannot put {value!r} into {kind.name}")

    return treat


def _redact(parameters: Parameters) -> TreatmentForType:
    """Replace any text by this one."""
    text = parameters.get("text")
    expect(parameters, "text")
    if not isinstance(text, str):
        raise FilterRefused("redact needs a text", 'for example {redact: {text: "***"}}')

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Text):
            return Constant(_serialized_text(text))
        raise FilterRefused(f"redact needs a string, not {kind.name}")

    return treat


def _truncate(parameters: Parameters) -> TreatmentForType:
    """At most `length` characters of a string or elements of an array."""
    length = number(parameters, "length")
    expect(parameters, "length")
    if not isinstance(length, int) or not 0 <= length < 1 << 32:
        raise FilterRefused("truncate needs a non-negative whole length")

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Text):
            return ContentTreatment(lambda content: _first_characters(content, length))
        if isinstance(kind, Array) and kind.length is None and kind.element.size:
            size = kind.element.size
            return ContentTreatment(lambda content: _first_elements(content, length, size))
        raise FilterRefused(
            "truncate needs a string or an array of variable length whose elements have a fixed"
            f" size above zero, not {kind.name}"
        )

    return treat


def _first_characters(content: Buffer, length: int) -> tuple[bytes, int]:
    text = str(content, "utf-8")[:length].encode()
    return text, len(text)


def _first_elements(content: Buffer, length: int, size: int) -> tuple[Buffer, int]:
    kept = content[: length * size]
    return kept, len(kept) // size


_Operator: TypeAlias = Callable[[Parameters, Keys | None], TreatmentForType]


def _keyless(operator: Callable[[Parameters], TreatmentForType]) -> _Operator:
    return lambda parameters, _: operator(parameters)


def _hash(parameters: Parameters, keys: Keys | None) -> TreatmentForType:
    """Replace a text by a pseudonym, equal for equal text and key (`filters.hashing`)."""
    length = integer(parameters, "length", 64) if "length" in parameters else DEFAULT_LENGTH
    expect(parameters, "key", *(parameters.keys() & {"length", "per"}))
    if parameters.get("per", RECEIVER) != RECEIVER:
        raise FilterRefused("per is receiver", "for example {hash: {key: ward, per: receiver}}")
    personal = "per" in parameters
    pseudonym = ContentTreatment(pseudonyms(parameters["key"], length, keys, personal=personal))

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Text):
            return pseudonym
        if isinstance(kind, Array):
            return DESCEND
        raise FilterRefused(f"hash needs a string, not {kind.name}")

    return treat


_REGION: Final = ("x", "y", "width", "height")
_SMALLEST: Final = 2  # pixels: a square of one is the picture


def _pixelate(parameters: Parameters) -> TreatmentForType:
    """Replace a picture, or a region of it, by squares of pixels; see `pictures`.

    They are of `block` pixels, or at most `across` along the longer side; of both the coarser.
    """
    names = _REGION if parameters.keys() & set(_REGION) else ()
    across = integer(parameters, "across", MAX_SIDE) if "across" in parameters else None
    sized = across is None or "block" in parameters
    block = integer(parameters, "block", MAX_SIDE, minimum=_SMALLEST) if sized else _SMALLEST
    region = tuple(integer(parameters, name, MAX_SIDE, minimum=0) for name in names)
    levels = integer(parameters, "levels", 256, minimum=2) if "levels" in parameters else None
    given = parameters.keys() & {"across", "levels"}
    expect(parameters, *(["block"] if sized else []), *names, *sorted(given))
    rewrite = pixelation(block, region or None, levels, across)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array) and kind.name == "uint8[]":
            return SiblingTreatment("sensor_msgs/Image", SIBLINGS, rewrite)
        raise FilterRefused(f"pixelate needs the data of a sensor_msgs/Image, not {kind.name}")

    return treat


def _sort(parameters: Parameters) -> TreatmentForType:
    """Elements in the order of their bytes, after all other filters; see `sorting`."""
    expect(parameters)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array) and kind.length is None and kind.element.size != 0:
            return ContentTreatment(sorting(kind.element))
        raise FilterRefused(
            f"sort needs an array of variable length whose elements have bytes, not {kind.name}"
        )

    return treat


OPERATORS: Final[dict[str, _Operator]] = {
    "clear": _keyless(_clear),
    "round": _keyless(_round),
    "clamp": _keyless(_clamp),
    "set": _keyless(_set),
    "redact": _keyless(_redact),
    "truncate": _keyless(_truncate),
    "drop": _keyless(_drop),
    "zero": _keyless(_zero),
    "hash": _hash,
    "pixelate": _keyless(_pixelate),
    "rooms": _keyless(rooms),
    "sort": _keyless(_sort),
}

# Applied to the result of the others of a restriction, and so beside filters inside their field.
AFTER_OTHERS: Final = frozenset({"sort"})


def treatment_for(rule: FilterRule, keys: Keys | None = None) -> TreatmentForType:
    """The function from field type to treatment that `rule` names.

    Args:
        rule: the rule.
        keys: by name, for `hash`. None: only check the rule; messages to be hashed are refused.

    Raises:
        FilterRefused: unknown operator, other parameters than the operator's, or a key that is
            not in `keys`. The returned function raises it for a type the operator cannot treat.
    """
    if rule.operator not in OPERATORS:
        close = difflib.get_close_matches(rule.operator, OPERATORS, 1)
        hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(OPERATORS)}"
        raise FilterRefused(f"{rule.path}: unknown operator {rule.operator[:40]!r}", hint)
    try:
        return OPERATORS[rule.operator](dict(rule.parameters), keys)
    except FilterRefused as error:
        raise FilterRefused(f"{rule.path}: {error}", error.hint) from None


def _pack(kind: Primitive, value: Scalar | None, operator: str) -> bytes:
    fits = isinstance(value, bool) if kind is PRIMITIVES["bool"] else not isinstance(value, bool)
    try:
        if fits and (kind.code not in _INTEGERS or isinstance(value, int)):
            return struct.pack(f"<{kind.code}", value)
    except (struct.error, OverflowError):
        pass
    raise FilterRefused(f"{operator} cannot put {value!r} into {kind.name}")


def _serialized_text(text: str) -> bytes:
    data = text.encode()
    return len(data).to_bytes(4, "little") + data
