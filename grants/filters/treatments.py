"""The vocabulary between rules and generated code: treatments of a field, and the treated layout.

A treatment is what an operator decided for one type; a node says for every part of a message
whether it is kept, treated, or gone into.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final, Literal, TypeAlias

from grants.filters.codegen import Buffer
from grants.filters.layout import Array, Struct, Type
from grants.filters.lazy_numpy import Vector
from grants.memory import HysteresisState

DESCEND: Final = "descend"


@dataclass(frozen=True)
class Constant:
    """These bytes stand in the field's place."""

    data: bytes


@dataclass(frozen=True)
class Remembering:
    """A `scalar` with a memory: `bind` makes it of the cell that the field has in it.

    `name` says what it does, so that only its like shares the cell.
    """

    name: tuple[float, ...]
    bind: Callable[[HysteresisState], Callable[..., Any]]


@dataclass(frozen=True)
class Numbers:
    """The values of a `Primitive` go through `scalar`, arrays of them through `vector`.

    `scalar` takes as many values as the type's format has, and returns as many (one: bare).
    With `remembering`, every field gets a `scalar` of its own from it;
    such a treatment has no place in an array, whose elements come and go.
    """

    scalar: Callable[..., Any]
    vector: Callable[[Vector], Vector]
    remembering: Remembering | None = None


@dataclass(frozen=True)
class ContentTreatment:
    """The content of a string or of an array, without its length, goes through `rewrite`.

    `rewrite(content)` returns the new content and the new length, in bytes or elements.
    """

    rewrite: Callable[[Buffer], tuple[Buffer, int]]


@dataclass(frozen=True)
class Inside:
    """Like `ContentTreatment`, for a field that can only be read with others of its message.

    `rewrite(content, *values)` gets the values of the fields `beside` (names and type names, in
    this order and before the field) as they were, in a message of type `message`.
    """

    message: str
    beside: tuple[tuple[str, str], ...]
    rewrite: Callable[..., tuple[Buffer, int]]


Treatment: TypeAlias = Constant | Numbers | ContentTreatment | Inside | Literal["descend"]


@dataclass(frozen=True)
class Keep:
    """Left as it is."""

    kind: Type


@dataclass(frozen=True)
class Treated:
    """A whole value of `kind` under one treatment (`Numbers` only for a `Primitive`)."""

    kind: Type
    treatment: Constant | Numbers | ContentTreatment | Inside


@dataclass(frozen=True)
class StructTreatment:
    """A message, field by field."""

    kind: Struct
    parts: tuple["Node", ...]


@dataclass(frozen=True)
class Each:
    """An array, every element alike."""

    kind: Array
    element: "Node"


Node: TypeAlias = Keep | Treated | StructTreatment | Each


def remembers(node: Node) -> bool:
    """Whether a treatment in `node` has a memory."""
    match node:
        case Treated(_, Numbers(remembering=remembering)):
            return remembering is not None
        case StructTreatment(_, parts):
            return any(map(remembers, parts))
        case _:
            return False
