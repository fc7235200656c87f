"""What filters and a rate let through, in the words of people: from the rules back to levels.

For rules of any origin: a level of a policy, a preset, a filter by hand, a grant of long ago. Only what is
certain counts: a word is at a level if every field that tells it is treated at least as strictly as by that
level, and the rate is no higher.
"""

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from grants.conditions import reads
from grants.filters.hashing import RECEIVER
from grants.model import FilterRule, Restriction
from grants.vocabulary import levels
from grants.vocabulary.contents import (
    EXACT,
    FRAMES,
    LEVELS,
    NO,
    TIMES,
    Content,
    DataWord,
    Description,
    FieldContent,
    rank,
)
from grants.vocabulary.levels import METRES_PER_DEGREE, Level, Treatment, level_of, treatment_at

_HIDING: Final = frozenset({"clear", "drop", "zero", "set", "redact"})
_METRES: Final = {Content.COORDINATE: 1.0, Content.DEGREES: float(METRES_PER_DEGREE)}
_ALMOST: Final = 1 + 1e-9  # a rate of 1/30 is a float
_ROOM: Final = level_of(DataWord.POSITION, "room").treatments[Content.COORDINATE]
_UNCOUNTED: Final = TIMES | FRAMES  # every attack used the time of arrival, which no filter hides
# One message in 5 s: 2 m left 1.05 m to the attacker, at 10 Hz 0.40 to 0.66 m (a cell that is told
# once leaves 0.82 m): movement through the borders averages the steps away.
_SELDOM: Final = 0.2
_PER_RECEIVER: Final = ("per", RECEIVER)
_MAX_CONDITIONS: Final = 3
_MAX_TEXT: Final = 80
TOPICS: Final[Mapping[DataWord, str]] = {
    DataWord.POSITION: "where it is",
    DataWord.MOVEMENT: "how it moves",
    DataWord.IMAGE: "pictures",
    DataWord.SOUND: "sound",
    DataWord.PRESENCE: "when it is there",
    DataWord.IDENTITY: "names and numbers of devices",
    DataWord.HOME: "the state of the home",
}
HIDDEN: Final[Mapping[DataWord, str]] = {
    DataWord.POSITION: "not where it is",
    DataWord.MOVEMENT: "not how it moves",
    DataWord.IMAGE: "no pictures",
    DataWord.SOUND: "no sound",
    DataWord.IDENTITY: "no names and numbers of devices",
    DataWord.HOME: "nothing of the state of the home",
}
SAID: Final[Mapping[tuple[DataWord, str], str]] = {
    (DataWord.POSITION, "room"): "the room",
    (DataWord.POSITION, "area"): "the area",
    (DataWord.MOVEMENT, "rough"): "roughly",
    (DataWord.IMAGE, "blurred"): "blurred",
    (DataWord.PRESENCE, "minute"): "to the minute",
    (DataWord.PRESENCE, "hour"): "to the hour",
    (DataWord.IDENTITY, "pseudonym"): "as pseudonyms",
    (DataWord.HOME, "rough"): "roughly",
}


class Seen(NamedTuple):
    """How one word is let through."""

    word: DataWord
    level: str  # the coarsest that holds; `exact` holds always
    # Of a position, metres of the finest step if no relative gives it away, infinite if it is hidden; else
    # 0. At full rate it is less than it says: `level` needs the rate.
    size: float = 0.0
    open: tuple[str, ...] = ()  # the fields that keep it from being coarser than `exact`
    by: tuple[DataWord, ...] = ()  # with all its own fields hidden: the words whose fields still tell it
    conditions: tuple[str, ...] = ()  # those on fields that tell it, as written: `level` is then `exact`
    besides: str = EXACT  # the level if these conditions were not there
    is_often: bool = False  # messages come so often that a position is known better than by `size`
    is_shared: bool = False  # names are pseudonyms that are the same for every receiver
    outdoors: bool = False  # the type is of degrees on the earth

    @property
    def size_text(self) -> str:
        return "" if self.is_often else self.step_text

    @property
    def step_text(self) -> str:
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
    """How messages are let through under all of these restrictions of one right together.

    `rate` is a further one, messages a second. Without `words` those the type carries as its own; a word
    that it tells only by relatives, as a velocity the position, can be asked for.
    """
    given = list(restrictions)
    rules = [rule for each in given for rule in each.filters]
    rates = [each for each in (rate, *(each.rate for each in given)) if each is not None]
    slots = [each.slot for each in given if each.slot is not None]
    limits = _Limits(min(rates, default=math.inf), max(slots, default=0), outdoors=description.is_outdoors)
    treated = [
        (field, [Treatment(rule.operator, rule.parameters) for rule in filters_of(rules, field.path)])
        for field in description.fields
    ]
    asked = description.words if words is None else words
    texts = list(dict.fromkeys(text for each in given for text in each.conditions))
    return {word: _seen(word, treated, limits, texts) for word in asked if description.tells(word)}


class _Limits(NamedTuple):
    rate: float
    slot: int
    outdoors: bool

    def hold(self, word: DataWord, level: Level) -> bool:
        # A rate is no slot for what is about times, and as seldom for the rest.
        slot = level.slot_for(outdoors=self.outdoors) or 0
        interval = max(1 / self.rate, self.slot)
        if word is DataWord.PRESENCE:
            return self.slot >= slot
        return interval * _ALMOST >= slot and (level.rate is None or interval * _ALMOST * level.rate >= 1)


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
    # A condition on a relative makes the word exact: it reads messages as they are, and that one comes tells
    # what held.
    level = EXACT if told else besides
    is_open = level == EXACT and size == 0
    open_fields = tuple(
        field.path
        for field, found in telling
        if is_open and (not found or any(reads(text, field.path) for text in told))
    )
    is_often = max(1 / limits.rate, limits.slot) * _SELDOM * _ALMOST < 1 and 0 < size < math.inf
    # Only `per: receiver` is missing to a level of pseudonyms.
    personal = [
        (field, [each._replace(parameters=(*each.parameters, _PER_RECEIVER)) for each in found])
        for field, found in telling
    ]
    is_shared = word is DataWord.IDENTITY and level == EXACT and _level(word, personal, limits) != EXACT
    shown = {field.meaning.own for field, found in telling if not any(map(_hides, found))}
    by = () if word in shown else tuple(other for other in DataWord if other in shown)
    return Seen(word, level, size, open_fields, by, told, besides, is_often, is_shared, limits.outdoors)


def _level(word: DataWord, telling: _Treated, limits: _Limits) -> str:
    # What is hidden altogether is so at any rate.
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


def _is_at_least(found: Treatment, wanted: Treatment) -> bool:
    if _hides(found):
        return True
    if found.operator == levels.OPERATOR:
        # As large, and with a hysteresis as wide, as a policy's `rooms` must be.
        kept = float(dict(found.parameters).get("hysteresis", 0))
        wide = levels.narrowest(found) >= levels.NARROWEST and levels.smallest(found) >= levels.SMALLEST
        return wanted == _ROOM and wide and kept >= levels.HYSTERESIS
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


def _hides(treatment: Treatment) -> bool:
    cut = treatment.operator == "truncate" and dict(treatment.parameters)["length"] == 0
    return treatment.operator in _HIDING or cut


def _width(treatment: Treatment) -> float:
    # Metres of the cells of one treatment: of rooms, the side of the smallest as a square.
    if treatment.operator == levels.OPERATOR:
        return min(math.sqrt(levels.smallest(treatment)), 2 * levels.narrowest(treatment))
    return float(dict(treatment.parameters)["step"]) if treatment.operator == "round" else 0.0


def _size(telling: _Treated) -> float:
    finest = math.inf
    for field, found in telling:
        if any(_hides(one) for one in found):
            continue
        metres = _METRES.get(field.content)
        width = max(map(_width, found), default=0.0)
        finest = min(finest, _cell(field, found) if metres is None else width * metres)
    return finest


def _cell(field: FieldContent, found: Iterable[Treatment]) -> float:
    for name in ("area", "room"):
        level = level_of(DataWord.POSITION, name)
        wanted = treatment_at(level, field)
        cell = level.treatments[Content.COORDINATE]
        if wanted is not None and cell and any(_is_at_least(one, wanted) for one in found):
            return _width(cell)
    return 0.0


def filters_of(filters: Iterable[FilterRule], path: str) -> list[FilterRule]:
    """The rules that apply to the field at `path`: its own, and those of its parents.

    `sort` of an array hides which element is which, but nothing of its fields.
    """
    steps = path.replace("[*]", "").split(".")
    found = []
    for rule in filters:
        above = rule.path.replace("[*]", "").split(".")
        if steps[: len(above)] == above and rule.operator != "sort":
            found.append(rule)
    return found


def seen(one: Seen) -> str:
    """One word: `where it is: the room`, `not how it moves`."""
    if one.conditions:
        return f"{TOPICS[one.word]}: {_told(one)}"
    return HIDDEN[one.word] if one.level == NO else f"{TOPICS[one.word]}: {_level_text(one)}"


def sentence(found: Iterable[Seen]) -> str:
    """All of them; empty if there is nothing to say."""
    return "; ".join(seen(one) for one in found)


def details(one: Seen) -> str:
    """The numbers of a level: `no finer than 4 m, at most one message in 30 s`; maybe none."""
    if one.level == NO or (one.by and not one.conditions):
        return ""
    parts = []
    if one.word is DataWord.POSITION and one.level != EXACT and math.isfinite(one.size):
        parts.append(f"no finer than {one.size:.3g} m")
    level = level_of(one.word, one.level)
    if level.rate is not None:
        parts.append(f"at most one message in {_time(1 / level.rate)}")
    slot = level.slot_for(outdoors=one.outdoors)
    if slot is not None:
        parts.append(f"one message at the start of each {_time(slot)}")
    if one.level == EXACT and one.open:
        parts.append(f"{one.open[0]} is as it is")
    return ", ".join(parts)


def _told(one: Seen) -> str:
    said: list[str] = []
    for text in one.conditions[:_MAX_CONDITIONS]:
        shown = re.sub(r"\bmsg\.", "", " ".join(text.split()))
        shown = "".join(each if each.isprintable() else "?" for each in shown)
        said.append(shown if len(shown) <= _MAX_TEXT else f"{shown[: _MAX_TEXT - 3]}...")
    texts = " and ".join(said)
    more = len(one.conditions) - _MAX_CONDITIONS
    told = f"whether {texts}" + (f" and {more} more" if more > 0 else "")
    if one.besides == NO:
        return told
    return f"{_level_text(one._replace(conditions=(), level=one.besides))}, and {told}"


def _level_text(one: Seen) -> str:
    if one.by:
        return f"only by {' and '.join(TOPICS[word] for word in one.by)}"
    if (one.word, one.level) in SAID:
        return SAID[one.word, one.level]
    if one.is_shared:
        return "as pseudonyms that are the same for all receivers"
    if one.is_often and one.step_text:
        return f"in steps of {one.step_text}, and finer while it moves"
    return f"to {one.size_text}" if one.size_text else "exactly"


def _time(seconds: float) -> str:
    whole = round(seconds)
    return f"{whole // 60} minutes" if whole > 60 else f"{whole} s"
