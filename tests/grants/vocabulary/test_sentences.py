"""Words and levels as people say them."""

import math

import pytest

from grants.vocabulary.assess import HIDDEN, SAID, TOPICS, Seen, details, seen, sentence
from grants.vocabulary.contents import EXACT, LEVELS, NO, DataWord

P, M, PICTURE = DataWord.POSITION, DataWord.MOVEMENT, DataWord.IMAGE


def test_every_word_and_level_is_said() -> None:
    between = {
        (word, level) for word, levels in LEVELS.items() for level in levels if level not in (EXACT, NO)
    }
    assert set(SAID) == between
    assert set(TOPICS) == set(DataWord)
    assert set(HIDDEN) == {word for word, levels in LEVELS.items() if NO in levels}


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (Seen(P, "room", 4.0), "where it is: the room"),
        (Seen(P, EXACT, 2.0), "where it is: to 2 m"),
        (Seen(P, EXACT), "where it is: exactly"),
        (Seen(P, NO, math.inf), "not where it is"),
        (Seen(PICTURE, NO), "no pictures"),
        (Seen(M, "rough"), "how it moves: roughly"),
        (Seen(M, EXACT, by=(P,)), "how it moves: only by where it is"),
        (Seen(DataWord.PRESENCE, "minute"), "when it is there: to the minute"),
    ],
)
def test_a_word_at_a_level(one: Seen, said: str) -> None:
    assert seen(one) == said


def test_a_sentence_has_all_words() -> None:
    assert sentence([Seen(P, "room", 4.0), Seen(M, NO)]) == ("where it is: the room; not how it moves")
    assert sentence([]) == ""


@pytest.mark.parametrize(
    ("one", "said"),
    [
        (Seen(P, "room", 4.0), "no finer than 4 m, one message at the start of each 30 s"),
        (Seen(P, "area", 20.0), "no finer than 20 m, one message at the start of each 5 minutes"),
        (Seen(P, "room", math.inf), "one message at the start of each 30 s"),
        (Seen(M, "rough", outdoors=True), "one message at the start of each 15 minutes"),
        (Seen(P, NO, math.inf), ""),
        (Seen(M, "rough", by=(P,)), ""),
        (Seen(P, EXACT, open=("twist.linear.x",)), "twist.linear.x is as it is"),
        (Seen(DataWord.IDENTITY, "pseudonym"), ""),
        (Seen(DataWord.PRESENCE, "minute"), "one message at the start of each 60 s"),
    ],
)
def test_the_numbers_of_a_level(one: Seen, said: str) -> None:
    assert details(one) == said


def test_what_conditions_tell_is_said_beside_the_level() -> None:
    texts = ("msg.pose.position.x < 5",)
    hidden = Seen(P, EXACT, conditions=texts, besides=NO)
    assert sentence([hidden]) == "where it is: whether pose.position.x < 5"
    room = Seen(P, EXACT, conditions=texts, besides="room")
    assert sentence([room]) == "where it is: the room, and whether pose.position.x < 5"
    many = Seen(P, EXACT, conditions=tuple(f"msg.x < {n}\x1b" for n in range(5)), besides=NO)
    assert sentence([many]) == ("where it is: whether x < 0? and x < 1? and x < 2? and 2 more")
    long = Seen(P, EXACT, conditions=("msg.x < 5 || " * 20,), besides=NO)
    assert len(sentence([long])) < 110


def test_steps_and_shared_pseudonyms_are_not_said_to_be_more() -> None:
    steps = sentence([Seen(P, EXACT, 2.0, is_often=True)])
    assert steps == "where it is: in steps of 2 m, and finer while it moves"
    shared = sentence([Seen(DataWord.IDENTITY, EXACT, is_shared=True)])
    assert shared.endswith("as pseudonyms that are the same for all receivers")
