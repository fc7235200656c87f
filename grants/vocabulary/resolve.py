"""Levels for messages of one type, resolved into the rules of a filter and a rate.

Every field that tells a coarse word is treated, also where the word is not its own: a velocity
beside a rounded position would be the exact path. Of several words the strictest treatment holds.
A type with an unknown field is refused, and so is `exact` for what another level hides.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final

from grants.errors import FilterRefused
from grants.filters.layout import Array, Layout, Struct, Type
from grants.filters.operators import treatment_for
from grants.model import FilterRule
from grants.vocabulary.contents import FRAMES, NAMES, TIMES, Content
from grants.vocabulary.describe import Description, FieldContent
from grants.vocabulary.levels import CLEAR, Level, Treatment, hiding, level_of
from grants.vocabulary.rooms import in_rooms
from grants.vocabulary.words import EXACT, DataWord

Levels = Mapping[DataWord, str]

# In an array these are hidden one by one: how many there are tells nothing of the word.
_IN_PLACE: Final = frozenset({Content.NAME, Content.MARK, Content.TEXT}) | FRAMES | TIMES
_OF_NAMES: Final = frozenset({DataWord.IDENTITY, DataWord.PRESENCE})
# The operators in the order of what they hide; they can be used on a message as a whole.
_STRICTNESS: Final = ("hash", "round", "pixelate", "zero", "clear")
_FOR_MESSAGES: Final = frozenset({"round", "clear"})


@dataclass(frozen=True)
class Resolved:
    """The rules, sorted by path, the rate and the slot; nothing if no level concerns the type."""

    rules: tuple[FilterRule, ...] = ()
    rate: float | None = None
    slot: int | None = None


def together(parts: Iterable[Resolved]) -> Resolved:
    """All rules, the lowest rate, the longest slot."""
    found = list(parts)
    return Resolved(
        tuple(sorted(rule for each in found for rule in each.rules)),
        min((each.rate for each in found if each.rate is not None), default=None),
        max((each.slot for each in found if each.slot is not None), default=None),
    )


def resolve(
    layout: Layout, description: Description, levels: Levels, rooms: Treatment | None = None
) -> Resolved:
    """The filter that holds `levels` on messages of `layout`, described by `description`.

    With `rooms` a position at the room is the point of its room, instead of a cell's middle.

    Raises:
        FilterRefused: a field is unknown, or what shall be exact would tell what shall not; an
            area of a position that has rooms.
    """
    coarse = {word: level for word, level in levels.items() if level != EXACT}
    _check_known(description, coarse)
    concerned = {
        word: level for word, level in coarse.items() if _is_concerned(description, word, levels)
    }
    if not concerned:
        return Resolved()
    treated = {
        field.path: _treatment(field, concerned, levels, description)
        for field in description.fields
    }
    _empty_arrays(description, treated, concerned)
    _check_exact(description, treated, levels)
    rules = [rule for name, kind in layout.root.fields for rule in _fold(kind, name, treated)[1]]
    rules += _sorted_arrays(description, treated)
    if rooms is not None:
        rules = [in_rooms(layout, rule, rooms) for rule in rules]
    limits = [level_of(word, level) for word, level in concerned.items()]
    outdoors = description.is_outdoors
    return together(
        [
            Resolved(tuple(rules)),
            *(Resolved((), each.rate, each.slot_for(outdoors=outdoors)) for each in limits),
        ]
    )


def _check_known(description: Description, coarse: Levels) -> None:
    unknown = [field for field in description.fields if field.content is Content.UNKNOWN]
    bare = [field for field in description.fields if field.content is Content.BARE]
    if coarse and unknown:
        raise FilterRefused(
            f"what {unknown[0].path} of {description.type_name} tells is not known, so no level"
            " can be held",
            f"say it: vocabulary: {{{description.type_name}: {{{unknown[0].path}: position}}}}",
        )
    if coarse.keys() - {DataWord.PRESENCE} and bare:
        raise FilterRefused(
            f"{bare[0].path} of {description.type_name} is a bare value: only its topic knows what"
            " it tells",
            f"say it: vocabulary: {{/the/topic: {{{bare[0].path}: home}}}}",
        )


def _treatment(
    field: FieldContent, coarse: Levels, levels: Levels, description: Description
) -> Treatment | None:
    """The strictest treatment of a field, or None: it is kept.

    A time is told of identity beside names: it is the same for every receiver, so two would know
    by it which pseudonyms are one.
    """
    matches = field.content in TIMES and description.has_names
    found: list[Treatment] = []
    for word, level in coarse.items():
        if _is_told(field, word, levels) or (matches and word is DataWord.IDENTITY):
            wanted = treatment_at(level_of(word, level), field)
            found += [] if wanted is None else [wanted]
    return max(found, key=_strictness, default=None)


def _is_told(field: FieldContent, word: DataWord, levels: Levels) -> bool:
    """A rule that says a level for the field's own word has decided what may be recognised."""
    recognised = word in field.meaning.hints and field.meaning.own not in levels
    return word in field.meaning.tells or recognised


def _is_concerned(description: Description, word: DataWord, levels: Levels) -> bool:
    """Whether anything but times and names of frames tells the word; presence is told by any."""
    if word is DataWord.PRESENCE:
        return True
    telling = [one for one in description.fields if _is_told(one, word, levels)]
    beside = TIMES if word is DataWord.IDENTITY else TIMES | FRAMES
    return any(one.content not in beside for one in telling)


def _strictness(treatment: Treatment) -> tuple[int, float]:
    step = dict(treatment.parameters).get("step", 0)
    return _STRICTNESS.index(treatment.operator), float(step)


def treatment_at(level: Level, field: FieldContent) -> Treatment | None:
    """What a level does to a field that tells its word; None keeps it."""
    hidden = hiding(field.content)
    wanted = level.treatments.get(field.content, hidden)
    return wanted if wanted is None or _fits(field, wanted) else hidden


def _fits(field: FieldContent, wanted: Treatment) -> bool:
    """Whether the operator can be used here.

    Elements of an array have no hysteresis, and the place of a pseudonym in an array of names, as
    of joints, says whose it is.
    """
    if "hysteresis" in dict(wanted.parameters) and (field.array or isinstance(field.kind, Array)):
        return False
    if wanted.operator == "hash" and isinstance(field.kind, Array):
        return False
    try:
        treatment_for(FilterRule(field.path, *wanted))(field.kind)
    except FilterRefused:
        return False
    return True


def _empty_arrays(
    description: Description, treated: dict[str, Treatment | None], concerned: Levels
) -> None:
    """An array of messages is emptied if what is hidden in it would show by its number."""
    in_place = _IN_PLACE if concerned.keys() - _OF_NAMES else _IN_PLACE | NAMES
    emptied = {
        field.array
        for field in description.fields
        if field.array and treated[field.path] == CLEAR and field.content not in in_place
    }
    for field in description.fields:
        if field.array in emptied:
            treated[field.path] = CLEAR


def _check_exact(
    description: Description, treated: Mapping[str, Treatment | None], levels: Levels
) -> None:
    for word, level in levels.items():
        hidden = [
            field.path
            for field in description.carrying(word)
            if treated[field.path] is not None and field.content not in TIMES
        ]
        if level == EXACT and hidden:
            others = " and ".join(f"{w}: {at}" for w, at in levels.items() if at != EXACT)
            raise FilterRefused(
                f"{word} cannot be exact beside {others}: {hidden[0]} of {description.type_name}"
                " would tell it",
                f"leave out {word}: exact, or allow this topic in another rule",
            )


def _sorted_arrays(
    description: Description, treated: Mapping[str, Treatment | None]
) -> Iterator[FilterRule]:
    """Arrays whose elements lose their names: the order would tell which is which."""
    kept = {field.array for field in description.fields if treated[field.path] != CLEAR}
    nameless = {
        field.array
        for field in description.fields
        if field.array in kept and field.content in NAMES and treated[field.path]
    }
    for path in sorted(nameless - {""} - description.fixed_arrays):
        yield FilterRule(path, "sort")


_Common = Treatment | None


def _fold(
    kind: Type, path: str, treated: Mapping[str, Treatment | None]
) -> tuple[_Common, list[FilterRule]]:
    """The rules below `path`, one for a whole message where all of it is treated alike.

    The first value is that one treatment; None if there is none.
    """
    inner = kind.element if isinstance(kind, Array) else kind
    if not isinstance(inner, Struct):
        found = treated[path]
        return found, list(_rule(path, found))
    within = f"{path}[*]" if isinstance(kind, Array) else path
    parts = [_fold(member, f"{within}.{name}", treated) for name, member in inner.fields]
    common = {part for part, _ in parts}
    if len(common) == 1:
        [one] = common
        usable = one is not None and one.operator in _FOR_MESSAGES
        if one is not None and usable and (one == CLEAR or not isinstance(kind, Array)):
            return one, list(_rule(path, one))
    return None, [rule for _, rules in parts for rule in rules]


def _rule(path: str, treatment: Treatment | None) -> Iterator[FilterRule]:
    if treatment is not None:
        yield FilterRule(path, *treatment)
