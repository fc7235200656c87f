"""The graph a watcher builds from valid and malformed answers."""

from typing import Any

import pytest

from rossec.errors import AnswerMalformed
from rossec.participant.registrations import GraphView

A, B = ["publisher", "/t", "/a"], ["publisher", "/t", "/b"]


def answer(**changes: Any) -> dict[str, Any]:
    said = {
        "instance": "x",
        "version": 5,
        "cursor": 1,
        "whole": True,
        "more": False,
        "added": [A],
        "removed": [],
    }
    return {**said, **changes}


def test_the_whole_graph_is_followed_by_differences() -> None:
    view = GraphView()
    assert view.next_params == ("", 0)
    first = view.take(answer())
    assert (first.added, first.removed, first.restarted) == ((tuple(A),), (), False)
    assert (view.next_params, view.version) == (("x", 1), 5)
    second = view.take(answer(cursor=2, whole=False, added=[B], removed=[A], more=True))
    assert (second.added, second.removed, second.more) == ((tuple(B),), (tuple(A),), True)
    assert view.facts == {tuple(B)}


def test_a_restart_of_the_master_reports_differences_only() -> None:
    view = GraphView()
    view.take(answer(added=[A]))
    change = view.take(answer(instance="y", added=[A, B]))
    assert (change.added, change.removed, change.restarted) == ((tuple(B),), (), True)
    assert view.take(answer(instance="z", added=[])).removed == (tuple(A), tuple(B))


@pytest.mark.parametrize(
    "broken",
    [
        5,
        {},
        answer(instance=1),
        answer(version="1"),
        answer(cursor=None),
        answer(whole=1),
        answer(more=0),
        answer(added={}),
        answer(removed=[5]),
        answer(added=[["one", "two"]]),
        answer(added=[[*A, "four"]]),
        answer(added=[[1, "two", "three"]]),
    ],
)
def test_a_malformed_answer_changes_nothing(broken: object) -> None:
    view = GraphView()
    view.take(answer())
    before = vars(view).copy()
    with pytest.raises(AnswerMalformed):
        view.take(broken)
    assert vars(view) == before
