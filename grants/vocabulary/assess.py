"""What filters and a rate let through, in the words of people: from the rules back to levels.

For rules of any origin: a level of a policy, a preset, a filter by hand, a grant of long ago. Only
what is certain counts: a word is at a level if every field that tells it is treated at least as
strictly as by that level, and the rate is no higher; one open relative makes it exact. Times do not
count (every attack used the time of arrival), nor what may be recognised in a picture.
"""

import math
from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

from grants.model import FilterRule, Restriction
from grants.vocabulary import rooms
from grants.vocabulary.contents import FRAMES, TIMES, Content
from grants.vocabulary.describe import Description, FieldContent
from grants.vocabulary.levels import (
    METRES_PER_DEGREE,
    Level,
    Treatment,
    hiding,
    level_of,
)
from grants.vocabulary.words import EXACT, LEVELS, NO, DataWord, rank

_HIDING: Final = frozenset({"clear", "drop", "zero", "set", "redact"})
_METRES: Final = {Content.COORDINATE: 1.0, Content.DEGREES: float(METRES_PER_DEGREE)}
_ROOM: Final = level_of(DataWord.POSITION, "room").treatments[Content.COORDINATE]
_UNCOUNTED: Final = TIMES | FRAMES


class Seen(NamedTuple):
    """How one word is let through.

    Args:
        level: the coarsest that holds; `exact` holds always.
        size: of a position, metres of the finest step if no relative gives it away, infinite if
            it is hidden; else 0. At full rate it is less than it says: `level` needs the rate.
        open: the fields that keep it from being coarser than `exact`.
        by: with all its own fields hidden: the words whose fields still tell it.
    """

    word: DataWord
    level: str
    size: float = 0.0
    open: tuple[str, ...] = ()
    by: tuple[DataWord, ...] = ()

    @property
    def size_text(self) -> str:
        """`2 m` for a position between two levels; else empty."""
        between = self.level == EXACT and 0 < self.size < math.inf
        return f"{self.size:.3g} m" if between else ""

    def is_no_finer_than(self, limit: str | float) -> bool:
        """Whether it is at this level or a coarser one; of a position also by metres."""
        if isinstance(limit, str):
            return rank(self.word, self.level) >= rank(self.word, limit)
        return self.size >= limit


def assess(
    description: Description,
    restrictions: Iterable[Restriction],
    rate: float | None = None,
    words: Sequence[DataWord] | None = None,
) -> dict[DataWord, Seen]:
    """How messages are let through under all of these restrictions together.

    Args:
        description: of the type.
        restrictions: those of one right; conditions make nothing coarser.
        rate: a further one, messages a second.
        words: which; without them those the type carries as its own. A word that the type tells
            only by relatives, as a velocity the position, can be asked for.
    """
    given = list(restrictions)
    rules = [rule for each in given for rule in each.filters]
    rates = [each for each in (rate, *(each.rate for each in given)) if each is not None]
    slots = [each.slot for each in given if each.slot is not None]
    limits = _Limits(min(rates, default=math.inf), max(slots, default=0))
    treated = [(field, _of(rules, field.path)) for field in description.fields]
    asked = description.words if words is None else words
    return {word: _seen(word, treated, limits) for word in asked if description.tells(word)}


class _Limits(NamedTuple):
    rate: float
    slot: int

    def hold(self, level: Level) -> bool:
        """Whether messages are as seldom as at `level`: a slot of s seconds lets one in s pass."""
        rate = min(self.rate, 1 / self.slot if self.slot else math.inf)
        seldom = level.rate is None or rate <= level.rate
        return seldom and self.slot >= (level.slot or 0)


_Treated = list[tuple[FieldContent, list[Treatment]]]


def _seen(word: DataWord, treated: _Treated, limits: _Limits) -> Seen:
    telling = [
        (field, found)
        for field, found in treated
        if word in field.meaning.tells and field.content not in _UNCOUNTED
    ]
    size = _size(telling) if word is DataWord.POSITION else 0.0
    level = _level(word, telling, limits)
    is_open = level == EXACT and size == 0
    open_fields = tuple(field.path for field, found in telling if not found and is_open)
    return Seen(word, level, size, open_fields, _others(word, telling))


def _level(word: DataWord, telling: _Treated, limits: _Limits) -> str:
    """What is hidden altogether is so at any rate."""
    if NO in LEVELS[word] and _holds(Level(), telling):
        return NO
    for one in reversed(LEVELS[word][1:]):
        level = level_of(word, one)
        if limits.hold(level) and _holds(level, telling):
            return one
    return EXACT


def _holds(level: Level, telling: _Treated) -> bool:
    for field, found in telling:
        wanted = level.treatments.get(field.content, hiding(field.content))
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
    at_least = needs.keys() & {"step", "hysteresis", "block"}
    at_most = needs.keys() & {"levels"}
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
        metres = _METRES.get(field.content, 0.0)
        finest = min(finest, max(map(_width, found), default=0.0) * metres)
    return finest


def _of(rules: Iterable[FilterRule], path: str) -> list[Treatment]:
    """The treatments of the field at `path`: its own, and those of what it lies in."""
    steps = path.replace("[*]", "").split(".")
    found = []
    for rule in rules:
        above = rule.path.replace("[*]", "").split(".")
        if steps[: len(above)] == above and rule.operator != "sort":
            found.append(Treatment(rule.operator, rule.parameters))
    return found
