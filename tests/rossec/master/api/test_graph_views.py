"""Only changes are sent, in bounded answers, to whoever was sent the rest."""

from typing import Any

import pytest

from rossec.master.api import graph_calls
from rossec.master.api.graph_calls import MAX_VIEWS, Fact, GraphViews, View, is_unchanged

ME = b"me"


def facts(*names: str) -> View:
    return frozenset(("node", name, "http://h:1/") for name in names)


def names(answer: dict[str, Any], key: str) -> list[str]:
    rows: list[Fact] = answer[key]
    return [row[1] for row in rows]


@pytest.fixture
def views() -> GraphViews:
    return GraphViews("run")


def test_the_first_answer_is_whole_and_the_next_has_the_changes(views: GraphViews) -> None:
    first = views.answer(ME, ("", 0), facts("/a", "/b"), 1)
    assert (first["whole"], names(first, "added")) == (True, ["/a", "/b"])
    second = views.answer(ME, ("run", first["cursor"]), facts("/b", "/c"), 2)
    assert (second["whole"], names(second, "added"), names(second, "removed")) == (False, ["/c"], ["/a"])


def test_the_cursor_stays_while_nothing_changes(views: GraphViews) -> None:
    first = views.answer(ME, ("", 0), facts("/a"), 1)
    again = views.answer(ME, ("run", first["cursor"]), facts("/a"), 1)
    assert is_unchanged([1, "", again], first["cursor"])
    assert not is_unchanged([1, "", first], 0)
    assert not is_unchanged([-1, "refused", {}], 0)


def test_what_is_said_beside_the_facts_is_part_of_the_view(views: GraphViews) -> None:
    first = views.answer(ME, ("", 0), facts("/a"), 1, (b"list",))
    again = views.answer(ME, ("run", first["cursor"]), facts("/a"), 1, (b"list",))
    other = views.answer(ME, ("run", first["cursor"]), facts("/a"), 1, (b"newer",))
    assert is_unchanged([1, "", again], first["cursor"])
    assert not is_unchanged([1, "", other], first["cursor"])


@pytest.mark.parametrize("seen", [("other", 1), ("run", 99), ("run", "1")])
def test_a_view_that_is_not_known_is_answered_whole(views: GraphViews, seen: tuple[object, object]) -> None:
    views.answer(ME, ("", 0), facts("/a"), 1)
    assert views.answer(ME, seen, facts("/a"), 1)["whole"]
    assert views.answer(b"other", ("run", 1), facts("/a"), 1)["whole"]


def test_an_answer_is_bounded(views: GraphViews, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(graph_calls, "BATCH", 2)
    first = views.answer(ME, ("", 0), facts("/a", "/b", "/c"), 1)
    assert (names(first, "added"), first["more"]) == (["/a", "/b"], True)
    rest = views.answer(ME, ("run", first["cursor"]), facts("/a", "/b", "/c"), 1)
    assert (names(rest, "added"), rest["more"], rest["whole"]) == (["/c"], False, False)


def test_views_are_bounded_and_discarded(views: GraphViews) -> None:
    for number in range(2 * MAX_VIEWS):
        views.answer(ME, ("", 0), facts(f"/a{number}"), 1)
    assert len(views) == MAX_VIEWS
    views.keep_only(frozenset({ME}))
    assert len(views) == MAX_VIEWS
    views.keep_only(frozenset())
    assert len(views) == 0


def test_the_version_fits_into_xml_rpc(views: GraphViews) -> None:
    assert views.answer(ME, ("", 0), facts(), (1 << 31) + 5)["version"] == 5
