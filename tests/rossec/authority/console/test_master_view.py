"""What the master says to the console, asked only while somebody looks."""

import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from rossec.authority.console import queries as module
from rossec.authority.console.messages import DenialView, FactView, ListProgress, from_value
from rossec.authority.console.queries import DENIALS, FRESH, PERIOD, TRUST_STATUS, MasterView
from rossec.authority.session import StatementCall
from rossec.errors import NotDelivered
from rossec.participant.registrations import WATCH_GRAPH as WATCH
from tests.support.consoleacts import Acts
from tests.support.consolework import many

POSE = ["publisher", "/pose", "/robot"]


class Master:
    """Answers as a master does, or not at all."""

    def __init__(self) -> None:
        self.calls: list[StatementCall] = []
        self.reachable = True
        self.facts: list[list[Any]] = [POSE]
        self.parts: list[list[Any]] = []
        self.denials: Any = [[5, "/heating", 2, "/scan"]]
        self.trust_status: Any = {"list": "1.1", "nodes": 3, "holding": 2, "lacking": ["/map"]}

    def __call__(self, call: StatementCall) -> object:
        self.calls.append(call)
        if not self.reachable:
            raise NotDelivered("no master", call.hint)
        if call.method == TRUST_STATUS:
            return self.trust_status
        if call.method == DENIALS:
            return self.denials
        parts = self.parts
        if parts:
            added = [parts.pop(0)]
            return self._answer(added, whole=call.statement[1] == 0, more=bool(parts))
        return self._answer(self.facts, whole=True)

    def _answer(self, added: list[Any], *, whole: bool, more: bool = False) -> object:
        return {
            "instance": "i",
            "version": 1,
            "cursor": len(self.calls),
            "whole": whole,
            "more": more,
            "added": added,
            "removed": [],
        }

    def asked(self, method: str) -> int:
        return sum(call.method == method for call in self.calls)


class Looking:
    def __init__(self, root: Path) -> None:
        self.acts, self.master, self.elapsed = Acts(root), Master(), 100.0
        self.begun: list[Callable[[], None]] = []
        self.returns = 0
        self.view = MasterView(
            self.acts.work, self.master, lambda: self.elapsed, self.begun.append, self.returned
        )

    def returned(self) -> None:
        self.returns += 1

    def look(self) -> int:
        """Ask, if that is due, and look again."""
        self.view.look()
        while self.begun:
            self.begun.pop()()
        return self.view.look()

    def wait(self) -> None:
        self.elapsed += PERIOD


@pytest.fixture
def looking(tmp_path: Path) -> Looking:
    return Looking(tmp_path / "home")


def test_the_graph_is_asked_for_while_somebody_looks(looking: Looking) -> None:
    assert not looking.master.calls, "nobody looked yet"
    first = looking.look()
    assert looking.look() == first, "it is not asked again so soon"
    assert looking.master.asked(WATCH) == 1
    assert many(FactView, looking.view.graph()) == (FactView(*POSE),)
    assert looking.master.asked(WATCH) == 1, "what was heard is shown"
    assert all(call.waits for call in looking.master.calls)


def test_the_number_changes_with_what_the_master_says(looking: Looking) -> None:
    first = looking.look()
    looking.wait()
    assert looking.look() == first
    looking.master.facts = [POSE, ["subscriber", "/pose", "/map"]]
    looking.wait()
    second = looking.look()
    assert second != first
    looking.master.denials = [[6, "/heating", 2, "/scan"]]
    looking.wait()
    assert looking.look() == second, "the same denial, a second later"
    looking.master.denials = [[0, "/map", 2, "/scan"], [7, "/heating", 2, "/scan"]]
    looking.wait()
    assert looking.look() != second


def test_one_question_is_asked_at_a_time(looking: Looking) -> None:
    looking.view.look()
    looking.wait()
    looking.view.look()
    assert len(looking.begun) == 1
    looking.begun.pop()()
    looking.view.look()
    assert len(looking.begun) == 1


def test_without_a_fresh_answer_the_master_is_asked_at_once(looking: Looking) -> None:
    looking.master.parts = [["node", "/a", "http://a/"], ["node", "/b", "http://b/"]]
    assert [fact.name for fact in many(FactView, looking.view.graph())] == ["/a", "/b"]
    found = many(DenialView, looking.view.denials())
    assert found == (DenialView(looking.acts.now - 5, "/heating", 2, "/scan"),)
    looking.look()
    assert many(DenialView, looking.view.denials()) == found
    looking.elapsed += FRESH + 1
    looking.master.reachable = False
    for ask in (looking.view.graph, looking.view.denials):
        with pytest.raises(NotDelivered):
            ask()


def test_a_master_out_of_reach_or_malformed_ends_nothing(looking: Looking) -> None:
    looking.master.reachable = False
    first = looking.look()
    looking.master.reachable, looking.master.denials = True, 5
    looking.wait()
    assert looking.look() != first, "the graph"
    for rows in (5, [[1, 2]], ["x"]):
        looking.master.denials = rows
        looking.elapsed += FRESH + 1
        with pytest.raises(NotDelivered, match="malformed"):
            looking.view.denials()


def test_a_master_that_goes_is_told_at_once_and_one_that_comes_back_too(looking: Looking) -> None:
    """What waits for it, an approval or a list, need not wait for the next round."""
    before = looking.look()
    looking.wait()
    looking.master.reachable = False
    away = looking.look()
    assert away != before
    with pytest.raises(NotDelivered):
        looking.view.graph()
    looking.wait()
    assert looking.look() == away, "it is still away"
    assert looking.returns == 0
    looking.wait()
    looking.master.reachable = True
    looking.look()
    assert looking.returns == 1
    assert many(FactView, looking.view.graph()) == (FactView(*POSE),)
    looking.wait()
    looking.look()
    assert looking.returns == 1


def test_a_graph_without_end_is_refused(looking: Looking, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_FACTS", 3)
    looking.master.parts = [["node", f"/{number}", "u"] for number in range(9)]
    with pytest.raises(NotDelivered, match="more than 3 facts"):
        looking.view.graph()


def test_how_far_a_list_has_come(looking: Looking) -> None:
    acts = looking.acts
    acts.enroll("/lamp")
    epoch, seq = number(acts.removals.revoke_node("/lamp", "lost"))
    before = ask(looking, epoch, seq)
    assert before == ListProgress(epoch, seq, True, False, 3, 0)
    looking.master.trust_status = {"list": f"{epoch}.{seq}", "nodes": 3, "holding": 2, "lacking": []}
    assert ask(looking, epoch, seq) == ListProgress(epoch, seq, True, True, 3, 2)
    looking.master.trust_status["list"] = f"{epoch}.{seq + 7}"
    assert ask(looking, epoch, seq).is_at_master, "a newer one has it all"
    assert ask(looking, epoch, seq + 8) == ListProgress(epoch, seq + 8, False, False, 0, 0)


def test_zeros_ask_for_all_that_was_revoked_until_now(looking: Looking) -> None:
    acts = looking.acts
    acts.enroll("/lamp")
    acts.lock()
    assert number(acts.removals.revoke_node("/lamp", "lost")) == (0, 0)
    assert ask(looking, 0, 0) == ListProgress(0, 0, False, False, 0, 0)
    acts.unlock()
    acts.work.maintain()
    found = ask(looking, 0, 0)
    assert found.is_signed
    assert (found.epoch, found.seq) > (0, 0)


@pytest.mark.parametrize(
    "answer",
    [
        None,
        5,
        {"list": "1.1"},
        {"list": "1.1", "nodes": 1, "holding": 2},
        {"list": 1, "nodes": 1, "holding": 1},
    ],
)
def test_without_an_answer_what_was_published_is_known(looking: Looking, answer: object) -> None:
    acts = looking.acts
    acts.enroll("/lamp")
    epoch, seq = number(acts.removals.revoke_node("/lamp", "lost"))
    looking.master.trust_status = answer
    looking.master.reachable = answer is not None
    assert ask(looking, epoch, seq) == ListProgress(epoch, seq, True, False, 0, 0)
    acts.work.maintain()
    assert ask(looking, epoch, seq) == ListProgress(epoch, seq, True, True, 0, 0)


@pytest.mark.parametrize("text", ["", "1", "1.", ".1", "a.b", "-1.2", "1.2.3", "9" * 30 + ".1"])
def test_a_number_of_another_form_is_none(looking: Looking, text: str) -> None:
    acts = looking.acts
    acts.enroll("/lamp")
    epoch, seq = number(acts.removals.revoke_node("/lamp", "lost"))
    looking.master.trust_status = {"list": text, "nodes": 1, "holding": 1}
    assert not ask(looking, epoch, seq).is_at_master


def test_a_page_with_ticks_is_not_kept_waiting_by_the_graph(looking: Looking) -> None:
    looking.look()
    acts = looking.acts
    acts.enroll("/lamp")
    epoch, seq = number(acts.removals.revoke_node("/lamp", "lost"))
    ask(looking, epoch, seq)
    before, watched = looking.look(), looking.master.asked(WATCH)
    looking.master.trust_status = {"list": f"{epoch}.{seq}", "nodes": 3, "holding": 3, "lacking": []}
    looking.wait()
    assert looking.look() != before
    assert looking.master.asked(WATCH) == watched


def test_questions_are_asked_in_a_thread_of_their_own(tmp_path: Path) -> None:
    acts, threads = Acts(tmp_path / "home"), list[str]()

    def deliver(call: StatementCall) -> object:
        threads.append(threading.current_thread().name)
        raise NotDelivered("no master", call.hint)

    MasterView(acts.work, deliver).look()
    end = time.monotonic() + 10
    while not threads and time.monotonic() < end:
        time.sleep(0.01)
    assert threads == ["questions to the master"]


def ask(looking: Looking, epoch: int, seq: int) -> ListProgress:
    return from_value(ListProgress, looking.view.trust_status(epoch, seq))


def number(value: object) -> tuple[int, int]:
    assert isinstance(value, list)
    epoch, seq = value
    return epoch, seq
