"""What each content tells."""

import pytest

from grants.vocabulary.contents import MEANINGS, NOT_KNOWN, TIMES, Content, DataWord, Meaning, fields_by


def test_every_content_has_a_meaning() -> None:
    assert set(MEANINGS) == set(Content)


@pytest.mark.parametrize("content", Content)
def test_a_content_tells_its_own_word(content: Content) -> None:
    meaning = MEANINGS[content]
    assert meaning.own is None or meaning.own in meaning.tells
    assert not meaning.tells & meaning.hints


@pytest.mark.parametrize("word", DataWord)
def test_every_word_is_carried(word: DataWord) -> None:
    assert [content for content in Content if MEANINGS[content].own is word]


def test_what_is_not_known_may_tell_everything() -> None:
    content = set(DataWord) - {DataWord.PRESENCE}
    assert all(MEANINGS[unknown].tells >= content for unknown in NOT_KNOWN)


def test_a_time_tells_when_something_changed_but_not_who_it_was() -> None:
    assert all(MEANINGS[time].tells == set(DataWord) - {DataWord.IDENTITY} for time in TIMES)


def test_only_format_tells_nothing() -> None:
    silent = [c for c in Content if not MEANINGS[c].tells and not MEANINGS[c].hints]
    assert silent == [Content.FORMAT]


def test_the_path_follows_from_a_velocity_and_the_speed_from_positions() -> None:
    assert DataWord.POSITION in MEANINGS[Content.VELOCITY].tells
    assert DataWord.MOVEMENT in MEANINGS[Content.COORDINATE].tells
    assert DataWord.POSITION in MEANINGS[Content.DISTANCE].tells


def test_a_table_names_fields_by_their_content() -> None:
    found = fields_by(coordinate="x y", child_frame="child_frame_id")
    frame = Content.CHILD_FRAME
    assert found == {"x": Content.COORDINATE, "y": Content.COORDINATE, "child_frame_id": frame}
    with pytest.raises(ValueError, match="'place' is not a valid Content"):
        fields_by(place="x")


def test_a_meaning_tells_its_own_word_and_others() -> None:
    meaning = Meaning.of(DataWord.HOME, DataWord.POSITION)
    assert meaning == Meaning(DataWord.HOME, frozenset({DataWord.HOME, DataWord.POSITION}))
