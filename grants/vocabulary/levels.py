"""What each level does: its rate, and the treatment of each content that tells its word.

One table. What it does not list is hidden: cleared, or emptied where it is an array. The steps of
one word nest (5 is odd, and a cell is centred), so the coarser level is a function of the finer
one; a rate never rises. Position and movement have slots, not rates: they are sampled at
moments that are the same for all topics and receivers, and a publisher that sends when something
happens does not tell when. The slot follows the cell: one of 2.2 km is crossed in minutes, and a
sample in the middle of crossing tells the border. `python -m bench privacy` measures what is left.
Sixteen squares across in 8 greys show a face only where somebody is close.
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
        slot: seconds of a slot (`grants.limits`); None if it sets none.
        outdoors: seconds of a slot where there are degrees on the earth; None: `slot`.
        treatments: by content; None keeps a field as it is. A content that tells the word and is
            not listed is hidden.
    """

    rate: float | None = None
    treatments: Mapping[Content, Treatment | None] = {}
    slot: int | None = None
    outdoors: int | None = None

    def slot_for(self, *, outdoors: bool) -> int | None:
        """The seconds of a slot for a type with degrees on the earth, or one without."""
        return self.outdoors if outdoors and self.outdoors is not None else self.slot


_Table: TypeAlias = Mapping[tuple[DataWord, str], Level]

CLEAR: Final = Treatment("clear")
PSEUDONYM_KEY: Final = "identity"  # the publisher's key for pseudonyms
METRES_PER_DEGREE: Final = 111_320  # of latitude


def in_steps(step: float) -> Treatment:
    """Rounding with hysteresis: at a border a value does not tell where it is by changing."""
    return Treatment("round", (("hysteresis", step / 2), ("step", step)))


_CLIMATE: Final[dict[Content, Treatment | None]] = {
    Content.AMBIENT_TEMPERATURE: in_steps(2.0),
    Content.AMBIENT_HUMIDITY: in_steps(0.1),
    Content.AMBIENT_BRIGHTNESS: in_steps(200.0),
}
"""So coarse, what differs from room to room tells no more than the room."""
_CHARGE: Final[dict[Content, Treatment | None]] = {Content.CHARGE: in_steps(0.25)}


def position_in(metres: float, degrees: float) -> dict[Content, Treatment | None]:
    """A position in cells: of metres in a frame, of degrees on the earth."""
    return {
        Content.COORDINATE: in_steps(metres),
        Content.DEGREES: in_steps(degrees),
        Content.FRAME: None,  # without it the coordinates mean nothing
    }


_PSEUDONYM: Final = Treatment("hash", (("key", PSEUDONYM_KEY), ("per", "receiver")))

LEVEL_TABLE: Final[_Table] = {
    (DataWord.POSITION, "room"): Level(
        None, position_in(4.0, 0.02) | _CLIMATE | _CHARGE, 30, 900
    ),
    (DataWord.POSITION, "area"): Level(None, position_in(20.0, 0.1) | _CHARGE, 300, 3600),
    (DataWord.POSITION, NO): Level(slot=300, outdoors=3600),
    (DataWord.MOVEMENT, "rough"): Level(
        None,
        {
            Content.COORDINATE: in_steps(4.0), Content.DEGREES: in_steps(0.02),
            Content.VELOCITY: in_steps(0.5), **_CLIMATE, **_CHARGE,
        },
        30,
        900,
    ),
    (DataWord.MOVEMENT, NO): Level(slot=30, outdoors=900),
    (DataWord.IMAGE, "blurred"): Level(
        1.0,
        {Content.PICTURE: Treatment("pixelate", (("across", 16), ("block", 32), ("levels", 8)))},
    ),
    (DataWord.IMAGE, NO): Level(1.0),
    (DataWord.SOUND, NO): Level(1 / 60),
    (DataWord.PRESENCE, "minute"): Level(slot=60),
    (DataWord.PRESENCE, "hour"): Level(slot=3600),
    (DataWord.IDENTITY, "pseudonym"): Level(
        None,
        dict.fromkeys(
            (Content.NAME, Content.REQUEST, Content.FRAME, Content.CHILD_FRAME), _PSEUDONYM
        ),
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
}  # fmt: skip


def level_of(word: DataWord, level: str) -> Level:
    """A level by its name; `exact` does nothing."""
    return Level() if level == EXACT else LEVEL_TABLE[word, level]


def hiding(content: Content) -> Treatment:
    """What hides a field: a picture keeps its size, so that programs can still read it."""
    return Treatment("zero") if content is Content.PICTURE else CLEAR
