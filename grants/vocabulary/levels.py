"""What each level does: its rate, and the treatment of each content that tells its word.

One table. What it does not list is hidden: cleared, or emptied where it is an array. The steps of
one word nest (5 is odd, and a cell is centred), so the coarser level is a function of the finer
one; a rate never rises. The figures are those of presets, which attackers' programs measure
(`python -m bench privacy`): step 4, hysteresis 2 and one message in 30 s leave an error of 2.6 m,
squares of 32 pixels in 8 greys a face in twenty, slots of a minute an arrival to 37 s.
"""

from collections.abc import Mapping
from typing import Final, NamedTuple, TypeAlias

from grants.model import Scalar
from grants.vocabulary.contents import Content
from grants.vocabulary.words import EXACT, NO, DataWord


class Treatment(NamedTuple):
    """An operator of `grants.filters.operators` with its parameters, sorted by name."""

    operator: str
    parameters: tuple[tuple[str, Scalar], ...] = ()


class Level(NamedTuple):
    """One level of one word.

    Args:
        rate: messages a second; None if it sets none.
        slot: seconds of a slot (`grants.limits`), for what is about times; None if it sets none.
        treatments: by content; None keeps a field as it is. A content that tells the word and is
            not listed is hidden.
    """

    rate: float | None = None
    treatments: Mapping[Content, Treatment | None] = {}
    slot: int | None = None


_Table: TypeAlias = Mapping[tuple[DataWord, str], Level]

CLEAR: Final = Treatment("clear")
PSEUDONYM_KEY: Final = "identity"  # the publisher's key for pseudonyms
METRES_PER_DEGREE: Final = 111_320  # of latitude


def in_steps(step: float) -> Treatment:
    """Rounding with hysteresis: at a border a value does not tell where it is by changing."""
    return Treatment("round", (("hysteresis", step / 2), ("step", step)))


def position_in(metres: float, degrees: float) -> Mapping[Content, Treatment | None]:
    """A position in cells: of metres in a frame, of degrees on the earth."""
    return {
        Content.COORDINATE: in_steps(metres),
        Content.DEGREES: in_steps(degrees),
        Content.FRAME: None,  # without it the coordinates mean nothing
    }


_PSEUDONYM: Final = Treatment("hash", (("key", PSEUDONYM_KEY), ("per", "receiver")))

LEVEL_TABLE: Final[_Table] = {
    (DataWord.POSITION, "room"): Level(1 / 30, position_in(4.0, 0.02)),
    (DataWord.POSITION, "area"): Level(1 / 300, position_in(20.0, 0.1)),
    (DataWord.POSITION, NO): Level(1 / 300),
    (DataWord.MOVEMENT, "rough"): Level(
        1 / 30, {Content.COORDINATE: in_steps(4.0), Content.DEGREES: in_steps(0.02),
                 Content.VELOCITY: in_steps(0.5)},
    ),
    (DataWord.MOVEMENT, NO): Level(1 / 30),
    (DataWord.IMAGE, "blurred"): Level(
        1.0, {Content.PICTURE: Treatment("pixelate", (("block", 32), ("levels", 8)))}
    ),
    (DataWord.IMAGE, NO): Level(1.0),
    (DataWord.SOUND, NO): Level(1 / 60),
    (DataWord.PRESENCE, "minute"): Level(slot=60),
    (DataWord.PRESENCE, "hour"): Level(slot=3600),
    (DataWord.IDENTITY, "pseudonym"): Level(
        None,
        {Content.NAME: _PSEUDONYM, Content.FRAME: _PSEUDONYM, Content.CHILD_FRAME: _PSEUDONYM},
    ),
    (DataWord.IDENTITY, NO): Level(),
    (DataWord.HOME, "rough"): Level(
        1 / 60,
        {
            Content.TEMPERATURE: in_steps(2.0),
            Content.HUMIDITY: in_steps(0.1),
            Content.BRIGHTNESS: in_steps(200.0),
            Content.PRESSURE: in_steps(1000.0),
            Content.CHARGE: in_steps(0.25),
        },
    ),
    (DataWord.HOME, NO): Level(1 / 60),
}  # fmt: skip


def level_of(word: DataWord, level: str) -> Level:
    """A level by its name; `exact` does nothing."""
    return Level() if level == EXACT else LEVEL_TABLE[word, level]


def hiding(content: Content) -> Treatment:
    """What hides a field: a picture keeps its size, so that programs can still read it."""
    return Treatment("zero") if content is Content.PICTURE else CLEAR
