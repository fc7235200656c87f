"""How words and levels are said: `where it is: the room; not how it moves`.

One table, for the command line and the console. The numbers are those of the table of levels.
"""

import math
import re
from collections.abc import Iterable, Mapping
from typing import Final

from grants.vocabulary.assess import Seen
from grants.vocabulary.levels import level_of
from grants.vocabulary.words import EXACT, NO, DataWord

TOPICS: Final[Mapping[DataWord, str]] = {
    DataWord.POSITION: "where it is",
    DataWord.MOVEMENT: "how it moves",
    DataWord.IMAGE: "pictures",
    DataWord.SOUND: "sound",
    DataWord.PRESENCE: "when it is there",
    DataWord.IDENTITY: "names and numbers of devices",
    DataWord.HOME: "the state of the home",
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


HIDDEN: Final[Mapping[DataWord, str]] = {
    DataWord.POSITION: "not where it is",
    DataWord.MOVEMENT: "not how it moves",
    DataWord.IMAGE: "no pictures",
    DataWord.SOUND: "no sound",
    DataWord.IDENTITY: "no names and numbers of devices",
    DataWord.HOME: "nothing of the state of the home",
}


_MAX_CONDITIONS: Final = 3
_MAX_TEXT: Final = 80


def seen(one: Seen) -> str:
    """One word: `where it is: the room`, `not how it moves`."""
    if one.conditions:
        return f"{TOPICS[one.word]}: {_told(one)}"
    return HIDDEN[one.word] if one.level == NO else f"{TOPICS[one.word]}: {_level(one)}"


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
    """What conditions tell, beside what the fields do: `whether pose.position.x < 5`."""
    texts = " and ".join(_condition(text) for text in one.conditions[:_MAX_CONDITIONS])
    more = len(one.conditions) - _MAX_CONDITIONS
    told = f"whether {texts}" + (f" and {more} more" if more > 0 else "")
    if one.besides == NO:
        return told
    return f"{_level(one._replace(conditions=(), level=one.besides))}, and {told}"


def _condition(text: str) -> str:
    shown = re.sub(r"\bmsg\.", "", " ".join(text.split()))
    shown = "".join(each if each.isprintable() else "?" for each in shown)
    return shown if len(shown) <= _MAX_TEXT else f"{shown[: _MAX_TEXT - 3]}..."


def _level(one: Seen) -> str:
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
