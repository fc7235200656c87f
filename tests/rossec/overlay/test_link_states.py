"""The states of a link as a graph."""

from rossec.overlay.link_states import ENDED, NEXT, OPEN, LinkState


def test_every_state_is_reached_and_only_ends_are_final() -> None:
    reached = set(NEXT.values()) | {LinkState.IDLE, LinkState.RESET}  # a reset ends every state
    assert reached == set(LinkState)
    assert {state for state, _ in NEXT} == set(LinkState) - ENDED


def test_data_is_sent_between_the_answer_and_the_end() -> None:
    assert {NEXT[LinkState.OPENING, "answer"], NEXT[LinkState.RUNNING, "finish"]} == OPEN
