"""The states of a link as a graph."""

import re
from pathlib import Path

from rossec.overlay.link import ENDED, NEXT, OPEN, LinkState


def test_every_state_is_reached_and_only_ends_are_final() -> None:
    reached = set(NEXT.values()) | {LinkState.IDLE, LinkState.RESET}  # a reset ends every state
    assert reached == set(LinkState)
    assert {state for state, _ in NEXT} == set(LinkState) - ENDED


def test_data_is_sent_between_the_answer_and_the_end() -> None:
    assert {NEXT[LinkState.OPENING, "answer"], NEXT[LinkState.RUNNING, "finish"]} == OPEN


SPECIFICATION = Path(__file__).parents[3] / "docs" / "spec" / "overlay.md"


def test_the_specification_draws_these_states() -> None:
    text = SPECIFICATION.read_text()
    drawn = set(re.findall(r"^  ([A-Z]+) --> ([A-Z]+): ", text, re.MULTILINE))
    assert drawn == {(state.name, target.name) for (state, _), target in NEXT.items()}
