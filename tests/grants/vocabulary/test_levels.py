"""The table of levels: complete, in order, and its steps nest."""

import itertools

import pytest

from grants.filters.operators import treatment_for
from grants.model import FilterRule
from grants.vocabulary.contents import EXACT, LEVELS, MEANINGS, NO, Content, DataWord
from grants.vocabulary.levels import CLEAR, LEVEL_TABLE, Level, hiding, in_steps, level_of, position_in

ALL = [(word, level) for word, levels in LEVELS.items() for level in levels[1:]]


def test_every_level_has_a_row_and_there_is_no_other() -> None:
    assert set(LEVEL_TABLE) == set(ALL)


@pytest.mark.parametrize("word", DataWord)
def test_a_rate_never_rises(word: DataWord) -> None:
    rates = [level_of(word, level).rate or float("inf") for level in LEVELS[word]]
    assert rates == sorted(rates, reverse=True)
    slots = [level_of(word, level).slot or 0 for level in LEVELS[word]]
    assert slots == sorted(slots)
    for shorter, longer in itertools.pairwise(slots):
        assert shorter == 0 or longer % shorter == 0, "slots nest"


@pytest.mark.parametrize(("word", "level"), ALL)
def test_the_operators_are_those_of_grants(word: DataWord, level: str) -> None:
    for content, treatment in LEVEL_TABLE[word, level].treatments.items():
        if treatment is not None:
            treatment_for(FilterRule("field", *treatment))
        meaning = MEANINGS[content]
        assert word in meaning.tells | meaning.hints, "a row that is never used"


@pytest.mark.parametrize("word", DataWord)
def test_steps_grow_and_nest(word: DataWord) -> None:
    """Cells are centred: only an odd multiple is made of whole cells."""
    for finer, coarser in zip(LEVELS[word][1:], LEVELS[word][2:], strict=False):
        for content, treatment in level_of(word, coarser).treatments.items():
            before = level_of(word, finer).treatments.get(content, CLEAR)
            if treatment is None:
                assert before is None
            elif treatment.operator == "round":
                assert before is not None
                factor = dict(treatment.parameters)["step"] / dict(before.parameters)["step"]  # type: ignore[operator]
                assert round(factor) % 2 == 1
                assert factor == pytest.approx(round(factor))


def test_exact_does_nothing_and_no_hides_everything() -> None:
    assert all(level_of(word, EXACT) == Level() for word in DataWord)
    assert all(not level_of(word, NO).treatments for word in DataWord if NO in LEVELS[word])


def test_a_hidden_picture_keeps_its_size() -> None:
    assert hiding(Content.PICTURE).operator == "zero"
    assert hiding(Content.COORDINATE) == CLEAR


def test_a_position_is_in_cells_with_half_a_step_of_hysteresis() -> None:
    cells = position_in(4.0, 0.02)
    assert cells[Content.COORDINATE] == in_steps(4.0)
    assert cells[Content.DEGREES] == in_steps(0.02)
    assert in_steps(4.0).parameters == (("hysteresis", 2.0), ("step", 4.0))
    assert cells[Content.FRAME] is None
