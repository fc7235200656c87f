"""The types between rules and generated code: treatments of a field, and the treated layout.

A treatment is the result of an operator for one type; a node says for every part of a message
whether it is kept, treated, or entered.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from grants.common_state import HysteresisState
from grants.filters.codegen import Buffer
from grants.filters.layout import Array, Primitive, Struct, Type
from grants.filters.lazy_numpy import Vector

DESCEND: Final = "descend"


@dataclass(frozen=True)
class Constant:
    """These bytes replace the field."""

    data: bytes


@dataclass(frozen=True)
class HysteresisBinding:
    """A `scalar` with hysteresis: `bind` makes it from the state of the field.

    `parameters` are part of the state's key, so that only equal treatments share the state.
    """

    parameters: tuple[object, ...]
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
    """Left as it is."""

    kind: Type


@dataclass(frozen=True)
class FieldTreatment:
    """A whole value of `kind` under one treatment (`Numbers` only for a `Primitive`)."""

    kind: Type
    treatment: Constant | Numbers | ContentTreatment | SiblingTreatment


@dataclass(frozen=True)
class StructTreatment:
    """A message, field by field."""

    kind: Struct
    parts: tuple["Node", ...]


@dataclass(frozen=True)
class ArrayTreatment:
    """An array, with one treatment for every element."""

    kind: Array
    element: "Node"


Node: TypeAlias = Keep | FieldTreatment | StructTreatment | ArrayTreatment


def has_hysteresis(node: Node) -> bool:
    """Whether a treatment in `node` has hysteresis."""
    match node:
        case FieldTreatment(_, Numbers(hysteresis=hysteresis)):
            return hysteresis is not None
        case StructTreatment(_, parts):
            return any(map(has_hysteresis, parts))
        case _:
            return False
