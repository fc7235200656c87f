"""What filters and a rate let through, in the words of people: from the rules back to levels.

For rules of any origin: a level of a policy, a preset, a filter by hand, a grant of long ago. Only
what is certain counts: a word is at a level if every field that tells it is treated at least as
strictly as by that level, and the rate is no higher; one open relative makes it exact, and so does
a condition on one: conditions read messages as they are, and that one comes tells what held. Times
do not count (every attack used the time of arrival), nor what may be recognised in a picture.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from grants.conditions.fields import reads
from grants.filters.hashing import RECEIVER
from grants.model import FilterRule, Restriction
from grants.vocabulary import rooms
from grants.vocabulary.contents import FRAMES, TIMES, Content
from grants.vocabulary.describe import Description, FieldContent
from grants.vocabulary.levels import (
    METRES_PER_DEGREE,
    Level,
    Treatment,
    level_of,
)
from grants.vocabulary.resolve import treatment_at
from grants.vocabulary.words import EXACT, LEVELS, NO, DataWord, rank

_HIDING: Final = frozenset({"clear", "drop", "zero", "set", "redact"})
_METRES: Final = {Content.COORDINATE: 1.0, Content.DEGREES: float(METRES_PER_DEGREE)}
_ALMOST: Final = 1 + 1e-9  # a rate of 1/30 is a float
_ROOM: Final = level_of(DataWord.POSITION, "room").treatments[Content.COORDINATE]
_UNCOUNTED: Final = TIMES | FRAMES
# One message in 5 s: 2 m left 1.05 m to the attacker, at 10 Hz 0.40 to 0.66 m (a cell that is told
# once leaves 0.82 m): movement through the borders averages the steps away.
_SELDOM: Final = 0.2
_PER_RECEIVER: Final = ("per", RECEIVER)


class Seen(NamedTuple):
    """How one word is let through.

    Args:
        level: the coarsest that holds; `exact` holds always.
        size: of a position, metres of the finest step if no relative gives it away, infinite if
            it is hidden; else 0. At full rate it is less than it says: `level` needs the rate.
        open: the fields that keep it from being coarser than `exact`.
        by: with all its own fields hidden: the words whose fields still tell it.
        conditions: those on fields that tell it, as they are written: `level` is then `exact`.
        besides: the level if these conditions were not there.
        is_often: whether messages come so often that a position is known better than by `size`.
        is_shared: whether names are pseudonyms that are the same for every receiver.
        outdoors: the type is of degrees on the earth.
    """

    word: DataWord
    level: str
    size: float = 0.0
    open: tuple[str, ...] = ()
    by: tuple[DataWord, ...] = ()
    conditions: tuple[str, ...] = ()
    besides: str = EXACT
    is_often: bool = False
    is_shared: bool = False
    outdoors: bool = False

    @property
    def size_text(self) -> str:
        """`2 m` for a position between two levels; else empty."""
        return "" if self.is_often else self.step_text

    @property
    def step_text(self) -> str:
        """As `size_text`, of steps that are known better by their number."""
        between = self.level == EXACT and 0 < self.size < math.inf
        return f"{self.size:.3g} m" if between else ""

    def is_no_finer_than(self, limit: str | float) -> bool:
        """Whether it is at this level or a coarser one; of a position also by metres."""
        if isinstance(limit, str):
            return rank(self.word, self.level) >= rank(self.word, limit)
        return self.size >= limit and not self.is_often


def assess(
    description: Description,
    restrictions: Iterable[Restriction],
    rate: float | None = None,
    words: Sequence[DataWord] | None = None,
) -> dict[DataWord, Seen]:
    """How messages are let through under all of these restrictions together.

    Args:
        description: of the type.
        restrictions: those of one right; a condition makes what it reads exact.
        rate: a further one, messages a second.
        words: which; without them those the type carries as its own. A word that the type tells
            only by relatives, as a velocity the position, can be asked for.
    """
    given = list(restrictions)
    rules = [rule for each in given for rule in each.filters]
    rates = [each for each in (rate, *(each.rate for each in given)) if each is not None]
    slots = [each.slot for each in given if each.slot is not None]
    limits = _Limits(
        min(rates, default=math.inf), max(slots, default=0), outdoors=description.is_outdoors
    )
    treated = [(field, _of(rules, field.path)) for field in description.fields]
    asked = description.words if words is None else words
    texts = list(dict.fromkeys(text for each in given for text in each.conditions))
    return {word: _seen(word, treated, limits, texts) for word in asked if description.tells(word)}


class _Limits(NamedTuple):
    rate: float
    slot: int
    outdoors: bool

    def hold(self, word: DataWord, level: Level) -> bool:
        """Whether messages are as seldom as at `level`: a slot of s seconds lets one in s pass.

        A rate is no slot for what is about times, and as seldom for the rest.
        """
        slot = level.slot_for(outdoors=self.outdoors) or 0
        interval = max(1 / self.rate, self.slot)
        if word is DataWord.PRESENCE:
            return self.slot >= slot
        return interval * _ALMOST >= slot and (
            level.rate is None or interval * _ALMOST * level.rate >= 1
        )

    @property
    def are_often(self) -> bool:
        """Whether movement tells a position better than its steps."""
        return max(1 / self.rate, self.slot) * _SELDOM * _ALMOST < 1


_Treated = list[tuple[FieldContent, list[Treatment]]]


def _seen(word: DataWord, treated: _Treated, limits: _Limits, conditions: Sequence[str]) -> Seen:
    telling = [
        (field, found)
        for field, found in treated
        if word in field.meaning.tells and field.content not in _UNCOUNTED
    ]
    told = tuple(text for text in conditions if any(reads(text, f.path) for f, _ in telling))
    size = _size(telling) if word is DataWord.POSITION and not told else 0.0
    besides = _level(word, telling, limits)
    level = EXACT if told else besides
    is_open = level == EXACT and size == 0
    open_fields = tuple(
        field.path
        for field, found in telling
        if is_open and (not found or any(reads(text, field.path) for text in told))
    )
    is_often = limits.are_often and 0 < size < math.inf
    shared = _are_shared(word, telling, limits) if level == EXACT else False
    by = _others(word, telling)
    rest = (told, besides, is_often, shared, limits.outdoors)
    return Seen(word, level, size, open_fields, by, *rest)


def _are_shared(word: DataWord, telling: _Treated, limits: _Limits) -> bool:
    """Whether only `per: receiver` is missing to a level of pseudonyms."""
    personal = [
        (field, [each._replace(parameters=(*each.parameters, _PER_RECEIVER)) for each in found])
        for field, found in telling
    ]
    return word is DataWord.IDENTITY and _level(word, personal, limits) != EXACT


def _level(word: DataWord, telling: _Treated, limits: _Limits) -> str:
    """What is hidden altogether is so at any rate."""
    if NO in LEVELS[word] and _holds(Level(), telling):
        return NO
    for one in reversed(LEVELS[word][1:]):
        level = level_of(word, one)
        if limits.hold(word, level) and _holds(level, telling):
            return one
    return EXACT


def _holds(level: Level, telling: _Treated) -> bool:
    for field, found in telling:
        wanted = treatment_at(level, field)
        if wanted is not None and not any(_is_at_least(one, wanted) for one in found):
            return False
    return True


def _others(word: DataWord, telling: _Treated) -> tuple[DataWord, ...]:
    """The words whose fields tell this one, if its own fields are all hidden; else none."""
    shown = {field.meaning.own for field, found in telling if not any(map(_hides, found))}
    return () if word in shown else tuple(other for other in DataWord if other in shown)


def _is_at_least(found: Treatment, wanted: Treatment) -> bool:
    """Whether `found` hides at least what `wanted` does."""
    if _hides(found):
        return True
    if found.operator == rooms.OPERATOR:
        return wanted == _ROOM and _are_rooms(found)
    if found.operator != wanted.operator:
        return False
    has, needs = dict(found.parameters), dict(wanted.parameters)
    if "width" in has:  # a region of the picture: the rest is as it is
        return False
    if has.get("per") != needs.get("per"):  # the same for all: receivers compare, and so link
        return False
    at_least = needs.keys() & {"step", "hysteresis", "block"}
    at_most = needs.keys() & {"levels", "across"}
    return all(float(has.get(name, 0)) >= float(needs[name]) for name in at_least) and all(
        float(has.get(name, math.inf)) <= float(needs[name]) for name in at_most
    )


def _are_rooms(found: Treatment) -> bool:
    """Whether they are as large, and their hysteresis as wide, as a policy's `rooms` must be."""
    kept = float(dict(found.parameters).get("hysteresis", 0))
    wide = rooms.narrowest(found) >= rooms.NARROWEST and rooms.smallest(found) >= rooms.SMALLEST
    return wide and kept >= rooms.HYSTERESIS


def _hides(treatment: Treatment) -> bool:
    cut = treatment.operator == "truncate" and dict(treatment.parameters)["length"] == 0
    return treatment.operator in _HIDING or cut


def _width(treatment: Treatment) -> float:
    """Metres of the cells of one treatment: of rooms, the side of the smallest as a square."""
    if treatment.operator == rooms.OPERATOR:
        return min(math.sqrt(rooms.smallest(treatment)), 2 * rooms.narrowest(treatment))
    return float(dict(treatment.parameters)["step"]) if treatment.operator == "round" else 0.0


def _size(telling: _Treated) -> float:
    """Metres of the finest step; 0 if anything that tells the position is open."""
    finest = math.inf
    for field, found in telling:
        if any(_hides(one) for one in found):
            continue
        metres = _METRES.get(field.content)
        width = max(map(_width, found), default=0.0)
        finest = min(finest, _cell(field, found) if metres is None else width * metres)
    return finest


def _cell(field: FieldContent, found: Iterable[Treatment]) -> float:
    """Metres of the cells that a relative tells, as a charge in quarters; 0 if it is finer."""
    for name in ("area", "room"):
        level = level_of(DataWord.POSITION, name)
        wanted = treatment_at(level, field)
        cell = level.treatments[Content.COORDINATE]
        if wanted is not None and cell and any(_is_at_least(one, wanted) for one in found):
            return _width(cell)
    return 0.0


def _of(rules: Iterable[FilterRule], path: str) -> list[Treatment]:
    """The treatments of the field at `path`: its own, and those of what it lies in."""
    steps = path.replace("[*]", "").split(".")
    found = []
    for rule in rules:
        above = rule.path.replace("[*]", "").split(".")
        if steps[: len(above)] == above and rule.operator != "sort":
            found.append(Treatment(rule.operator, rule.parameters))
    return found
