"""The words and the order of their levels."""

import pytest

from grants.vocabulary.contents import EXACT, LEVELS, NO, DataWord, rank


def test_every_word_has_levels_that_begin_with_exact() -> None:
    assert list(LEVELS) == list(DataWord)
    assert {levels[0] for levels in LEVELS.values()} == {EXACT}
    assert all(len(set(levels)) == len(levels) >= 2 for levels in LEVELS.values())


def test_only_presence_cannot_be_hidden() -> None:
    assert [word for word in DataWord if NO not in LEVELS[word]] == [DataWord.PRESENCE]


@pytest.mark.parametrize("word", DataWord)
def test_the_rank_is_the_place(word: DataWord) -> None:
    assert [rank(word, level) for level in LEVELS[word]] == list(range(len(LEVELS[word])))


def test_no_other_level() -> None:
    with pytest.raises(ValueError, match="not in tuple"):
        rank(DataWord.POSITION, "kitchen")
