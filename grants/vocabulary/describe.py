"""The contents of a message type, field by field: what each tells, and which fields are unknown.

Types within a type are described by the same table (`types`), so a type that contains a pose is
described by what a pose is. What is not in the table, nor in the policy's own vocabulary, is
`unknown`: of such a type nothing can be said to be hidden.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NamedTuple

from grants.filters.layout import Array, Layout, Struct, Type
from grants.vocabulary.contents import (
    FRAMES,
    MEANINGS,
    NAMES,
    NOT_KNOWN,
    TIMES,
    Content,
    Fields,
    Meaning,
)
from grants.vocabulary.types import TYPES
from grants.vocabulary.words import DataWord

_NONE: Final[Fields] = {}


@dataclass(frozen=True)
class FieldContent:
    """One field without fields of its own.

    Args:
        path: as in filters: `pose.position.x`, `poses[*].position.x`.
        content: what it contains.
        kind: its type.
        array: the path of the outermost array of messages it lies in; else empty.
        is_fixed: whether that array has a fixed length.
    """

    path: str
    content: Content
    kind: Type
    array: str = ""
    is_fixed: bool = False

    @property
    def meaning(self) -> Meaning:
        """The words it tells."""
        return MEANINGS[self.content]


@dataclass(frozen=True)
class Description:
    """The fields of one message type, in order of its definition."""

    type_name: str
    fields: tuple[FieldContent, ...]

    @cached_property
    def unknown(self) -> tuple[str, ...]:
        """Paths of fields of which nothing is known; a bare value's meaning is its topic's."""
        return tuple(field.path for field in self.fields if field.content in NOT_KNOWN)

    @cached_property
    def words(self) -> tuple[DataWord, ...]:
        """The words that its fields have as their own, in order; `presence` is left out."""
        own = {field.meaning.own for field in self.fields if field.content not in TIMES}
        return tuple(word for word in DataWord if word in own)

    @cached_property
    def has_names(self) -> bool:
        """Whether it has names that can become pseudonyms, those of frames apart."""
        return any(field.content in NAMES for field in self.fields)

    @cached_property
    def is_outdoors(self) -> bool:
        """Whether a field is in degrees on the earth, so that cells are of kilometres."""
        return any(field.content is Content.DEGREES for field in self.fields)

    def carrying(self, word: DataWord) -> tuple[FieldContent, ...]:
        """The fields whose own word it is: `pose.position.x` for position."""
        return tuple(field for field in self.fields if field.meaning.own is word)

    def relatives(self, word: DataWord) -> tuple[FieldContent, ...]:
        """Fields of another word from which it can be computed; not times.

        Heading, velocity and scans for a position. Of a type that does not carry the word, it is
        what gives it away on another topic: the velocities of `/cmd_vel`, a map, joints.
        """
        return tuple(
            field
            for field in self.fields
            if field.meaning.own is not word
            and word in field.meaning.tells
            and field.content not in TIMES | NOT_KNOWN
        )

    def hints(self, word: DataWord) -> tuple[FieldContent, ...]:
        """Fields in which it may be recognised: a person in a picture; not names of frames."""
        return tuple(
            field
            for field in self.fields
            if word in field.meaning.hints and field.content not in FRAMES
        )

    def tells(self, word: DataWord) -> bool:
        """Whether anything but a time tells it: a level of the word concerns this type."""
        carried = self.carrying(word) or self.relatives(word) or self.hints(word)
        return word is DataWord.PRESENCE or len(carried) > 0

    @cached_property
    def fixed_arrays(self) -> frozenset[str]:
        """Paths of outermost arrays of messages that always have the same length."""
        return frozenset(field.array for field in self.fields if field.is_fixed)

    @cached_property
    def times(self) -> tuple[FieldContent, ...]:
        """Stamps and sequence numbers."""
        return tuple(field for field in self.fields if field.content in TIMES)


def describe(
    layout: Layout, own: Mapping[str, Fields] | None = None, here: Fields | None = None
) -> Description:
    """The contents of messages of `layout`.

    Args:
        layout: of the type.
        own: contents of further types by name, of a policy's vocabulary.
        here: contents of fields of this type on one topic: the meaning of a bare value.
    """
    found = _fields_of(layout.root, "", own or {}, here or _NONE, _Outermost())
    return Description(layout.type_name, tuple(found))


class _Outermost(NamedTuple):
    """The outermost array of messages around a field, if any."""

    path: str = ""
    is_fixed: bool = False


def _fields_of(
    kind: Struct, above: str, own: Mapping[str, Fields], given: Fields, array: _Outermost
) -> Iterator[FieldContent]:
    contents = {**TYPES.get(kind.name, _NONE), **own.get(kind.name, _NONE), **given}
    for name, member in kind.fields:
        within = {
            path.removeprefix(f"{name}."): content
            for path, content in contents.items()
            if path.startswith(f"{name}.")
        }
        yield from _field(member, above + name, contents.get(name), own, within, array)


def _field(
    kind: Type,
    path: str,
    content: Content | None,
    own: Mapping[str, Fields],
    within: Fields,
    array: _Outermost,
) -> Iterator[FieldContent]:
    inner = kind.element if isinstance(kind, Array) else kind
    if not isinstance(inner, Struct):
        yield FieldContent(path, content or Content.UNKNOWN, kind, *array)
        return
    if isinstance(kind, Array):
        array = array if array.path else _Outermost(path, kind.length is not None)
        path = f"{path}[*]"
    if content is None:
        yield from _fields_of(inner, f"{path}.", own, within, array)
        return
    for name, member in inner.fields:
        yield from _field(member, f"{path}.{name}", content, own, _NONE, array)
