from typing import Any

import pytest

from rossec.errors import AnswerMalformed
from rossec.federation import site_state
from rossec.federation.site_state import MAX_PARTS, SiteCursor

NODE = ["node", "/robot", "http://robot:1/"]
PUBLISHER = ["publisher", "/pose", "/robot"]
TYPE = ["type", "/pose", "p/T"]


def answer(**changed: Any) -> dict[str, Any]:
    return {
        "instance": "a",
        "version": 1,
        "cursor": 1,
        "whole": False,
        "more": False,
        "added": [],
        "removed": [],
        "revocations": bytes(32),
        "domains": b"",
        **changed,
    }


def test_an_answer_is_taken_and_asked_for_again_from_there() -> None:
    cursor = SiteCursor()
    assert cursor.params == ("", 0)
    change = cursor.take(answer(whole=True, cursor=7, added=[NODE], revocations=b"r" * 32))
    assert change is not None
    assert change.whole
    assert change.added == {tuple(NODE)}
    assert not change.removed
    assert (change.revocations, change.domains) == (b"r" * 32, b"")
    assert cursor.params == ("a", 7)
    assert cursor.version == 1


def test_parts_are_gathered_in_their_order() -> None:
    cursor = SiteCursor()
    assert cursor.take(answer(whole=True, more=True, added=[NODE, PUBLISHER])) is None
    assert cursor.take(answer(more=True, removed=[PUBLISHER])) is None
    change = cursor.take(answer(version=2, added=[TYPE], domains=b"d" * 32))
    assert change is not None
    assert change.whole
    assert change.added == {tuple(NODE), tuple(TYPE)}
    assert change.removed == {tuple(PUBLISHER)}
    assert change.domains == b"d" * 32
    after = cursor.take(answer(version=2))
    assert after is not None
    assert after[:3] == (frozenset(), frozenset(), False)


def test_an_empty_answer_says_that_nothing_has_changed() -> None:
    cursor = SiteCursor()
    cursor.take(answer(whole=True, cursor=7, added=[NODE], domains=b"d" * 32))
    change = cursor.take({})
    assert change == (frozenset(), frozenset(), False, bytes(32), b"d" * 32)
    assert cursor.params == ("a", 7)
    cursor.take(answer(version=2, cursor=8, more=True, added=[TYPE]))
    rest = cursor.take({})
    assert rest is not None
    assert rest.added == {tuple(TYPE)}


def test_a_restart_in_the_middle_begins_anew() -> None:
    cursor = SiteCursor()
    cursor.take(answer(whole=True, more=True, added=[NODE]))
    change = cursor.take(answer(instance="b", version=0, whole=True, added=[PUBLISHER]))
    assert change is not None
    assert change.added == {tuple(PUBLISHER)}
    assert change.whole


def test_a_master_without_a_list_says_so_with_nothing() -> None:
    change = SiteCursor().take(answer(revocations="", domains=""))
    assert change is not None
    assert change.revocations == change.domains == b""
    bare = {k: v for k, v in answer().items() if k not in ("revocations", "domains")}
    assert SiteCursor().take(bare) is not None


@pytest.mark.parametrize(
    "wrong",
    [
        None,
        [],
        {},
        answer(version="1"),
        answer(cursor=None),
        answer(whole=1, more="no"),
        answer(added=[["node", "/a"]]),
        answer(added=[["node", "/a", 1]]),
        answer(removed="x"),
        answer(revocations=b"short"),
        answer(domains=5),
        answer(instance=b"a"),
    ],
    ids=lambda each: "answer",
)
def test_anything_else_is_refused(wrong: object) -> None:
    with pytest.raises(AnswerMalformed):
        SiteCursor().take(wrong)


def test_a_version_that_runs_backwards_is_an_error() -> None:
    cursor = SiteCursor()
    cursor.take(answer(version=5, whole=True))
    with pytest.raises(AnswerMalformed, match="backwards"):
        cursor.take(answer(version=4))
    assert cursor.take(answer(instance="b", version=0, whole=True)) is not None


def test_versions_are_counted_modulo() -> None:
    cursor = SiteCursor()
    cursor.take(answer(version=(1 << 31) - 1, whole=True))
    assert cursor.take(answer(version=0)) is not None


def test_an_answer_has_an_end() -> None:
    cursor = SiteCursor()
    for _ in range(MAX_PARTS):
        assert cursor.take(answer(more=True)) is None
    with pytest.raises(AnswerMalformed, match=f"more than {MAX_PARTS} parts"):
        cursor.take(answer(more=True))


def test_the_facts_of_an_answer_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(site_state, "MAX_GATHERED", 3)
    cursor = SiteCursor()
    assert cursor.take(answer(whole=True, more=True, added=[NODE, PUBLISHER])) is None
    with pytest.raises(AnswerMalformed, match="more than 3 facts"):
        cursor.take(answer(more=True, added=[TYPE], removed=[NODE]))


def test_parts_that_whole_makes_void_are_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else a site that begins anew again and again is asked for ever."""
    cursor = SiteCursor()
    for _ in range(MAX_PARTS):
        assert cursor.take(answer(whole=True, more=True, added=[NODE])) is None
    with pytest.raises(AnswerMalformed, match=f"more than {MAX_PARTS} parts"):
        cursor.take(answer(whole=True, more=True, added=[NODE]))
    assert cursor.params == ("", 0)
    assert cursor.take(answer(whole=True, added=[NODE])) is not None
    monkeypatch.setattr(site_state, "MAX_GATHERED", 3)
    for _ in range(3):
        assert cursor.take(answer(whole=True, more=True, added=[NODE])) is None
    with pytest.raises(AnswerMalformed, match="more than 3 facts"):
        cursor.take(answer(whole=True, more=True, added=[NODE]))


def test_a_new_connection_is_counted_anew_beside_what_is_held() -> None:
    cursor = SiteCursor()
    for _ in range(MAX_PARTS - 1):
        cursor.take(answer(whole=True, more=True, added=[NODE]))
    cursor.reconnected()
    for _ in range(MAX_PARTS - 1):
        assert cursor.take(answer(more=True)) is None
    with pytest.raises(AnswerMalformed, match="parts"):
        cursor.take(answer(more=True))
