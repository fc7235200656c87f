"""The operators of filters: one entry in `OPERATORS` each.

An operator reads its named parameters and returns a function from the type of a field to a treatment: a
constant in its place, a function of its numbers, or a function of its bytes. An operator that does not treat
a type itself returns `DESCEND`, and is then applied to a message's fields or an array's elements. Nothing
here is source text: generated code only *calls* it.
"""

import difflib
import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Final, Literal, TypeAlias

from grants.errors import FilterRefused
from grants.filters.coarsening import (
    MAX_SIDE,
    SIBLINGS,
    HysteresisState,
    Vector,
    np,
    pixelation,
    read_plan,
    round_floats,
    round_integers,
    round_times,
    snap_rows,
    snapping,
    with_hysteresis,
)
from grants.filters.hashing import DEFAULT_LENGTH, RECEIVER, Keys, pseudonyms
from grants.filters.layout import (
    PRIMITIVES,
    Array,
    Buffer,
    Cursor,
    Primitive,
    SourceWriter,
    Struct,
    Text,
    Type,
)
from grants.model import FilterRule, Scalar

DESCEND: Final = "descend"


@dataclass(frozen=True)
class Constant:
    """These bytes replace the field."""

    data: bytes


@dataclass(frozen=True)
class HysteresisBinding:
    """A `scalar` with hysteresis: `bind` makes it from the state of the field."""

    parameters: tuple[object, ...]  # part of the state's key, so that only equal treatments share the state
    bind: Callable[[HysteresisState], Callable[..., Any]]


@dataclass(frozen=True)
class Numbers:
    """`scalar` is applied to the values of a `Primitive`, `vector` to arrays of them.

    `scalar` takes as many values as the type's format has, and returns as many (a single one
    without a tuple). With `hysteresis`, every field gets its own `scalar` from it; such a
    treatment cannot be used in an array, whose elements have no identity between messages. A
    message of several numbers that is treated as one value has the `kind` it is read as.
    """

    scalar: Callable[..., Any]
    vector: Callable[[Vector], Vector]
    hysteresis: HysteresisBinding | None = None
    kind: Primitive | None = None


@dataclass(frozen=True)
class ContentTreatment:
    """`rewrite` is applied to the content of a string or of an array, without its length.

    `rewrite(content)` returns the new content and the new length, in bytes or elements.
    """

    rewrite: Callable[[Buffer], tuple[Buffer, int]]


@dataclass(frozen=True)
class SiblingTreatment:
    """Like `ContentTreatment`, for a field that can only be read with other fields of its message.

    `rewrite(content, *values)` gets the values of the fields `siblings` (names and type
    names, in this order and before the field), unfiltered, in a message of type `message`.
    """

    message: str
    siblings: tuple[tuple[str, str], ...]
    rewrite: Callable[..., tuple[Buffer, int]]


Treatment: TypeAlias = Constant | Numbers | ContentTreatment | SiblingTreatment | Literal["descend"]
TreatmentForType: TypeAlias = Callable[[Type], Treatment]


@dataclass(frozen=True)
class Keep:
    kind: Type


@dataclass(frozen=True)
class FieldTreatment:
    kind: Type
    treatment: Constant | Numbers | ContentTreatment | SiblingTreatment


@dataclass(frozen=True)
class StructTreatment:
    kind: Struct
    parts: tuple["Node", ...]


@dataclass(frozen=True)
class ArrayTreatment:
    kind: Array
    element: "Node"


Node: TypeAlias = Keep | FieldTreatment | StructTreatment | ArrayTreatment


def has_hysteresis(node: Node) -> bool:
    match node:
        case FieldTreatment(_, Numbers(hysteresis=hysteresis)):
            return hysteresis is not None
        case StructTreatment(_, parts):
            return any(map(has_hysteresis, parts))
        case _:
            return False


Parameters: TypeAlias = dict[str, Scalar]


# Parameters come from a signed grant or from a policy: exactly the operator's own, each of its type and in
# its range, or they are refused.
def expect(parameters: Parameters, *names: str) -> None:
    if parameters.keys() != set(names):
        wanted = ", ".join(names) or "no parameters"
        raise FilterRefused(f"expected {wanted}, found {', '.join(sorted(parameters)) or 'none'}")


def number(parameters: Parameters, name: str) -> float:
    value = parameters.get(name)
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise FilterRefused(f"{name} must be a number")
    if isinstance(value, int) and abs(value) >= 1 << 64:
        raise FilterRefused(f"{name} is beyond 64 bits")
    if math.isnan(value):
        raise FilterRefused(f"{name} must be a number")
    return value


def integer(parameters: Parameters, name: str, maximum: int, minimum: int = 1) -> int:
    value = parameters.get(name)
    if isinstance(value, bool) or not isinstance(value, int) or not minimum <= value <= maximum:
        raise FilterRefused(f"{name} must be a whole number from {minimum} to {maximum}")
    return value


_EMPTY: Final = Constant(bytes(4))
_INTEGERS: Final = frozenset("bBhHiIqQ")
_REGION: Final = ("x", "y", "width", "height")
_SMALLEST: Final = 2  # pixels: a square of one is the picture
_HYSTERESIS: Final = "hysteresis"  # so no room has this name
_MAX_REACH: Final = 1000  # metres
_POSITIONS: Final = (("x", "y"), ("x", "y", "z"), ("x", "y", "theta"))
_FLOATS: Final = (PRIMITIVES["float32"], PRIMITIVES["float64"])


# A message of x, y and z or theta is read as one value, whatever its type is called: which room it is in
# depends on all of them. Everything but x and y is cleared.
def rooms(parameters: Parameters) -> TreatmentForType:
    reach = number(parameters, _HYSTERESIS) if _HYSTERESIS in parameters else None
    if reach is not None and not 0 < reach <= _MAX_REACH:
        raise FilterRefused(f"hysteresis of rooms is above zero and at most {_MAX_REACH} m")
    plan = read_plan({name: text for name, text in parameters.items() if name != _HYSTERESIS})
    bind = snapping(plan, reach)
    identity = (*sorted(parameters.items()),)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array):
            return DESCEND
        names = tuple(name for name, _ in kind.fields) if isinstance(kind, Struct) else ()
        members = [member for _, member in kind.fields] if isinstance(kind, Struct) else []
        of = next((one for one in _FLOATS if all(member is one for member in members)), None)
        if names not in _POSITIONS or of is None:
            raise FilterRefused(
                f"rooms needs a message of x, y and maybe z or theta, not {kind.name}",
                "for example pose.position of a geometry_msgs/PoseStamped",
            )
        position = Primitive(kind.name, of.code * len(names), of.size * len(names))
        snap = bind(HysteresisState())
        found = Numbers(snap, snap_rows(snap, len(position.code)), kind=position)
        return found if reach is None else replace(found, hysteresis=HysteresisBinding(identity, bind))

    return treat


def sorting(element: Type) -> Callable[[Buffer], tuple[Buffer, int]]:
    # The function from the elements of an array to the same in the order of their bytes, and how many they
    # are: which is which would show by the order also without their names, and so what is left of them
    # decides alone. An element has at least one byte, as else nothing would say how many there are. It
    # raises one of `LAYOUT_ERRORS` for others.
    source = SourceWriter("b")
    source.line("p=0;l=[]")
    with source.block("while p<len(b)"):
        cursor = Cursor(source)
        cursor.position = ("p", 0)
        cursor.skip(element)
        source.line(f"e={cursor.at()}")
        source.line("l.append(b[p:e])")
        source.line("p=e")
    source.line("if p!=len(b): raise ValueError")
    source.line("return l")
    split = source.compile()

    def rewrite(content: Buffer) -> tuple[Buffer, int]:
        found = sorted(split(bytes(content)))
        return b"".join(found), len(found)

    return rewrite


def _clear(parameters: Parameters) -> TreatmentForType:
    expect(parameters)

    def treat(kind: Type) -> Treatment:
        if kind.size is not None:
            return Constant(bytes(kind.size))
        variable = isinstance(kind, Text) or (isinstance(kind, Array) and kind.length is None)
        return _EMPTY if variable else DESCEND

    return treat


def _drop(parameters: Parameters) -> TreatmentForType:
    expect(parameters)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Array) and kind.length is None:
            return _EMPTY
        raise FilterRefused(f"drop needs an array of variable length, not {kind.name}")

    return treat


def _zero(parameters: Parameters) -> TreatmentForType:
    # Zeros in place of the elements; the length stays, so images remain consistent.
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
    # With `hysteresis` a value keeps its cell until it is that far beyond the border.
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

        def scalar(value: float) -> float:
            # Compared in this order NaN becomes `low`.
            return min(value, high) if value >= low else low

        def vector(values: Vector) -> Vector:
            return np.where(values >= low, np.where(values > high, high, values), low)

        return Numbers(scalar, vector)

    return treat


def _set(parameters: Parameters) -> TreatmentForType:
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
    length = number(parameters, "length")
    expect(parameters, "length")
    if not isinstance(length, int) or not 0 <= length < 1 << 32:
        raise FilterRefused("truncate needs a non-negative whole length")

    def characters(content: Buffer) -> tuple[Buffer, int]:
        text = str(content, "utf-8")[:length].encode()
        return text, len(text)

    def treat(kind: Type) -> Treatment:
        if isinstance(kind, Text):
            return ContentTreatment(characters)
        if isinstance(kind, Array) and kind.length is None and kind.element.size:
            size = kind.element.size
            most = length * size
            return ContentTreatment(lambda content: (content[:most], len(content[:most]) // size))
        raise FilterRefused(
            "truncate needs a string or an array of variable length whose elements have a fixed"
            f" size above zero, not {kind.name}"
        )

    return treat


_Operator: TypeAlias = Callable[[Parameters, Keys | None], TreatmentForType]


def _keyless(operator: Callable[[Parameters], TreatmentForType]) -> _Operator:
    return lambda parameters, _: operator(parameters)


def _hash(parameters: Parameters, keys: Keys | None) -> TreatmentForType:
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


def _pixelate(parameters: Parameters) -> TreatmentForType:
    # They are of `block` pixels, or at most `across` along the longer side; of both the coarser.
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

    `keys` are by name, for `hash`. None: only check the rule; messages to be hashed are refused.
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
