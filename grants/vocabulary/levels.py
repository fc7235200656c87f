"""What each level does, in one table; levels for one message type, resolved into filters and a rate.

What the table does not list is hidden: cleared, or emptied where it is an array. A type with an unknown field
is refused, and so is `exact` for what another level hides. `python -m bench privacy` measures what is left.
"""

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

from grants.errors import FilterRefused
from grants.filters.coarsening import Room, read_plan
from grants.filters.layout import Array, Layout, Struct, Type
from grants.filters.operators import treatment_for
from grants.model import FilterRule, Scalar
from grants.vocabulary.contents import (
    EXACT,
    FRAMES,
    NAMES,
    NO,
    TIMES,
    Content,
    DataWord,
    Description,
    FieldContent,
)

Levels = Mapping[DataWord, str]


class Treatment(NamedTuple):
    """An operator of `grants.filters.operators` with its parameters, sorted by name."""

    operator: str
    parameters: tuple[tuple[str, Scalar], ...] = ()


class Level(NamedTuple):
    rate: float | None = None  # messages a second
    # By content; None keeps a field as it is. A content that tells the word and is not listed is hidden.
    treatments: Mapping[Content, Treatment | None] = {}
    slot: int | None = None  # seconds (`grants.limits`)
    outdoors: int | None = None  # the same where there are degrees on the earth; None: `slot`

    def slot_for(self, *, outdoors: bool) -> int | None:
        return self.outdoors if outdoors and self.outdoors is not None else self.slot


CLEAR: Final = Treatment("clear")
PSEUDONYM_KEY: Final = "identity"  # the publisher's key for pseudonyms
METRES_PER_DEGREE: Final = 111_320  # of latitude


def in_steps(step: float) -> Treatment:
    """Rounding with hysteresis: at a border a value does not tell where it is by changing."""
    return Treatment("round", (("hysteresis", step / 2), ("step", step)))


# So coarse, what differs from room to room tells no more than the room.
_CLIMATE: Final[dict[Content, Treatment | None]] = {
    Content.AMBIENT_TEMPERATURE: in_steps(2.0),
    Content.AMBIENT_HUMIDITY: in_steps(0.1),
    Content.AMBIENT_BRIGHTNESS: in_steps(200.0),
}
_CHARGE: Final[dict[Content, Treatment | None]] = {Content.CHARGE: in_steps(0.25)}


def position_in(metres: float, degrees: float) -> dict[Content, Treatment | None]:
    return {
        Content.COORDINATE: in_steps(metres),
        Content.DEGREES: in_steps(degrees),
        Content.FRAME: None,  # without it the coordinates mean nothing
    }


_PSEUDONYM: Final = Treatment("hash", (("key", PSEUDONYM_KEY), ("per", "receiver")))

# The steps of one word nest (5 is odd, and a cell is centred), so the coarser level is a function of the
# finer one; a rate never rises. Position and movement have slots, not rates: they are sampled at moments that
# are the same for all topics and receivers, and a publisher that sends when something happens does not tell
# when. The slot follows the cell: one of 2.2 km is crossed in minutes, and a sample in the middle of crossing
# tells the border. Sixteen squares across in 8 greys show a face only where somebody is close.
LEVEL_TABLE: Final[Mapping[tuple[DataWord, str], Level]] = {
    (DataWord.POSITION, "room"): Level(None, position_in(4.0, 0.02) | _CLIMATE | _CHARGE, 30, 900),
    (DataWord.POSITION, "area"): Level(None, position_in(20.0, 0.1) | _CHARGE, 300, 3600),
    (DataWord.POSITION, NO): Level(slot=300, outdoors=3600),
    (DataWord.MOVEMENT, "rough"): Level(
        None,
        {
            Content.COORDINATE: in_steps(4.0),
            Content.DEGREES: in_steps(0.02),
            Content.VELOCITY: in_steps(0.5),
            **_CLIMATE,
            **_CHARGE,
        },
        30,
        900,
    ),
    (DataWord.MOVEMENT, NO): Level(slot=30, outdoors=900),
    (DataWord.IMAGE, "blurred"): Level(
        1.0, {Content.PICTURE: Treatment("pixelate", (("across", 16), ("block", 32), ("levels", 8)))}
    ),
    (DataWord.IMAGE, NO): Level(1.0),
    (DataWord.SOUND, NO): Level(1 / 60),
    (DataWord.PRESENCE, "minute"): Level(slot=60),
    (DataWord.PRESENCE, "hour"): Level(slot=3600),
    (DataWord.IDENTITY, "pseudonym"): Level(
        None, dict.fromkeys((Content.NAME, Content.REQUEST, Content.FRAME, Content.CHILD_FRAME), _PSEUDONYM)
    ),
    (DataWord.IDENTITY, NO): Level(),
    (DataWord.HOME, "rough"): Level(
        1 / 60,
        {
            Content.TEMPERATURE: in_steps(2.0),
            Content.HUMIDITY: in_steps(0.1),
            Content.BRIGHTNESS: in_steps(200.0),
            Content.PRESSURE: in_steps(1000.0),
            **_CLIMATE,
            **_CHARGE,
        },
    ),
    (DataWord.HOME, NO): Level(1 / 60),
}


def level_of(word: DataWord, level: str) -> Level:
    return Level() if level == EXACT else LEVEL_TABLE[word, level]


def hiding(content: Content) -> Treatment:
    """What hides a field: a picture keeps its size, so that programs can still read it."""
    return Treatment("zero") if content is Content.PICTURE else CLEAR


OPERATOR: Final = "rooms"
SMALLEST: Final = 1.0  # square metres; a plan of smaller ones is a grid, not rooms
NARROWEST: Final = 0.8  # metres, of four areas by the circumference; of a long room twice its width
HYSTERESIS: Final = 0.5  # metres outside of a room that still count as in it
_ROOM: Final = level_of(DataWord.POSITION, "room").treatments[Content.COORDINATE]
_AREA: Final = level_of(DataWord.POSITION, "area").treatments[Content.COORDINATE]


def plan_treatment(plan: dict[str, Scalar]) -> Treatment:
    """The operator for a plan: corners by name, as in docs/spec/grant.md, section 6.4."""
    if "hysteresis" in plan:
        raise FilterRefused("no room can be called hysteresis", "call it otherwise")
    found = Treatment(OPERATOR, tuple(sorted({**plan, "hysteresis": HYSTERESIS}.items())))
    treatment_for(FilterRule("position", *found))
    if smallest(found) < SMALLEST:
        raise FilterRefused(f"a room has less than {SMALLEST:g} square metre", "corners in metres")
    if narrowest(found) < NARROWEST:
        hint = "a plan of strips tells where in a room; draw whole rooms"
        raise FilterRefused(f"a room is narrower than {NARROWEST / 2:g} metres", hint)
    return found


def smallest(rooms: Treatment) -> float:
    """Square metres of the smallest room of an operator `rooms`."""
    return min(_area(room.corners) for room in _plan(rooms))


def narrowest(rooms: Treatment) -> float:
    """Metres of the narrowest room: four times its area by its circumference, of a square its side.

    A strip of a millimetre has a square metre, too, if it is long enough.
    """
    around = ((room, math.fsum(math.dist(*edge) for edge in room.edges)) for room in _plan(rooms))
    return min(4 * _area(room.corners) / length for room, length in around)


def _plan(rooms: Treatment) -> tuple[Room, ...]:
    return read_plan({name: text for name, text in rooms.parameters if name != "hysteresis"})


def _area(corners: tuple[tuple[float, float], ...]) -> float:
    pairs = zip(corners, (*corners[1:], corners[0]), strict=True)
    return abs(math.fsum(x0 * y1 - x1 * y0 for (x0, y0), (x1, y1) in pairs)) / 2


# A rule that rounds a whole position to the cell of a room becomes the operator `rooms`. Rooms and the
# cells of an area do not nest, so a position that has rooms has no area.
def in_rooms(layout: Layout, rule: FilterRule, rooms: Treatment) -> FilterRule:
    given = (rule.operator, rule.parameters)
    if given not in (_ROOM, _AREA) or not _is_position(layout.root, rule.path, rooms):
        return rule
    if given == _AREA:
        raise FilterRefused(f"{rule.path}: where the policy has rooms, a position has no area", "room, or no")
    return FilterRule(rule.path, *rooms)


def _is_position(kind: Type, path: str, rooms: Treatment) -> bool:
    for name in path.split("."):
        found = dict(kind.fields).get(name) if isinstance(kind, Struct) else None
        if found is None:  # within an array
            return False
        kind = found
    try:
        treatment_for(FilterRule(path, *rooms))(kind)
    except FilterRefused:
        return False
    return isinstance(kind, Struct)


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
    """
    # 1. Nothing can be said of a type with an unknown field, nor of a bare value.
    coarse = {word: level for word, level in levels.items() if level != EXACT}
    unknown = [field for field in description.fields if field.content is Content.UNKNOWN]
    bare = [field for field in description.fields if field.content is Content.BARE]
    if coarse and unknown:
        raise FilterRefused(
            f"what {unknown[0].path} of {description.type_name} tells is not known, so no level can be held",
            f"say it: vocabulary: {{{description.type_name}: {{{unknown[0].path}: position}}}}",
        )
    if coarse.keys() - {DataWord.PRESENCE} and bare:
        raise FilterRefused(
            f"{bare[0].path} of {description.type_name} is a bare value: only its topic knows what it tells",
            f"say it: vocabulary: {{/the/topic: {{{bare[0].path}: home}}}}",
        )
    # 2. The strictest treatment of each field, by the words that concern the type (presence is of every one),
    # also where the word is not its own: a velocity beside a rounded position would be the exact path.
    concerned: dict[DataWord, str] = {}
    for word, level in coarse.items():
        beside = TIMES if word is DataWord.IDENTITY else TIMES | FRAMES
        telling = (one for one in description.fields if _is_told(one, word, levels))
        if word is DataWord.PRESENCE or any(one.content not in beside for one in telling):
            concerned[word] = level
    if not concerned:
        return Resolved()
    treated = {field.path: _treatment(field, concerned, levels, description) for field in description.fields}
    # 3. An array of messages is emptied if what is hidden in it would show by its number.
    in_place = _IN_PLACE if concerned.keys() - _OF_NAMES else _IN_PLACE | NAMES
    inside = [field for field in description.fields if field.array and field.content not in in_place]
    emptied = {field.array for field in inside if treated[field.path] == CLEAR}
    treated |= {field.path: CLEAR for field in description.fields if field.array in emptied}
    # 4. What is to be exact must be so. Then rules of whole messages where one treatment is that of all
    # within.
    _check_exact(description, treated, levels)
    rules = [rule for name, kind in layout.root.fields for rule in _fold(kind, name, treated)[1]]
    rules += _sorted_arrays(description, treated)
    if rooms is not None:
        rules = [in_rooms(layout, rule, rooms) for rule in rules]
    found, outdoors = [Resolved(tuple(rules))], description.is_outdoors
    for word, level in concerned.items():
        given = level_of(word, level)
        found.append(Resolved((), given.rate, given.slot_for(outdoors=outdoors)))
    return together(found)


def _treatment(
    field: FieldContent, coarse: Levels, levels: Levels, description: Description
) -> Treatment | None:
    # A time is told of identity beside names: it is the same for every receiver, so two would know by it
    # which pseudonyms are one.
    matches = field.content in TIMES and description.has_names
    found: list[Treatment] = []
    for word, level in coarse.items():
        if _is_told(field, word, levels) or (matches and word is DataWord.IDENTITY):
            wanted = treatment_at(level_of(word, level), field)
            found += [] if wanted is None else [wanted]
    return max(found, key=_strictness, default=None)


def _is_told(field: FieldContent, word: DataWord, levels: Levels) -> bool:
    recognised = word in field.meaning.hints and field.meaning.own not in levels
    return word in field.meaning.tells or recognised


def _strictness(treatment: Treatment) -> tuple[int, float]:
    step = dict(treatment.parameters).get("step", 0)
    return _STRICTNESS.index(treatment.operator), float(step)


def treatment_at(level: Level, field: FieldContent) -> Treatment | None:
    """What a level does to a field that tells its word; None keeps it."""
    hidden = hiding(field.content)
    wanted = level.treatments.get(field.content, hidden)
    return wanted if wanted is None or _fits(field, wanted) else hidden


def _fits(field: FieldContent, wanted: Treatment) -> bool:
    # Elements of an array have no hysteresis, and the place of a pseudonym in an array of names, as of
    # joints, says whose it is.
    if "hysteresis" in dict(wanted.parameters) and (field.array or isinstance(field.kind, Array)):
        return False
    if wanted.operator == "hash" and isinstance(field.kind, Array):
        return False
    try:
        treatment_for(FilterRule(field.path, *wanted))(field.kind)
    except FilterRefused:
        return False
    return True


def _check_exact(description: Description, treated: Mapping[str, Treatment | None], levels: Levels) -> None:
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


def _sorted_arrays(description: Description, treated: Mapping[str, Treatment | None]) -> Iterator[FilterRule]:
    # Arrays whose elements lose their names: the order would tell which is which.
    kept = {field.array for field in description.fields if treated[field.path] != CLEAR}
    nameless = {
        field.array
        for field in description.fields
        if field.array in kept and field.content in NAMES and treated[field.path]
    }
    for path in sorted(nameless - {""} - description.fixed_arrays):
        yield FilterRule(path, "sort")


def _fold(
    kind: Type, path: str, treated: Mapping[str, Treatment | None]
) -> tuple[Treatment | None, list[FilterRule]]:
    # The one treatment of all that is in it, if there is one, and the rules.
    inner = kind.element if isinstance(kind, Array) else kind
    if not isinstance(inner, Struct):
        found = treated[path]
        return found, [] if found is None else [FilterRule(path, *found)]
    within = f"{path}[*]" if isinstance(kind, Array) else path
    parts = [_fold(member, f"{within}.{name}", treated) for name, member in inner.fields]
    common = {part for part, _ in parts}
    if len(common) == 1:
        [one] = common
        usable = one is not None and one.operator in _FOR_MESSAGES
        if one is not None and usable and (one == CLEAR or not isinstance(kind, Array)):
            return one, [FilterRule(path, *one)]
    return None, [rule for _, rules in parts for rule in rules]
