"""The words for data, and the levels of each, from the most to the least that is shown.

A level is an upper limit of what a receiver learns: each lets through no more than the one before
it. What a level does to fields is in `levels`, which fields tell a word in `contents` and `types`.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Final

EXACT: Final = "exact"
NO: Final = "no"


class DataWord(StrEnum):
    """A kind of data, as people name it."""

    POSITION = "position"
    MOVEMENT = "movement"
    IMAGE = "image"
    SOUND = "sound"
    PRESENCE = "presence"
    IDENTITY = "identity"
    HOME = "home"


LEVELS: Final[Mapping[DataWord, tuple[str, ...]]] = {
    DataWord.POSITION: (EXACT, "room", "area", NO),
    DataWord.MOVEMENT: (EXACT, "rough", NO),
    DataWord.IMAGE: (EXACT, "blurred", NO),
    DataWord.SOUND: (EXACT, NO),
    # There is no `no`: a message that arrives tells that its sender works.
    DataWord.PRESENCE: (EXACT, "minute", "hour"),
    DataWord.IDENTITY: (EXACT, "pseudonym", NO),
    DataWord.HOME: (EXACT, "rough", NO),
}


def rank(word: DataWord, level: str) -> int:
    """The place of a level in the order of its word; 0 is `exact`."""
    return LEVELS[word].index(level)
