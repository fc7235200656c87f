"""What the master says to the console: the graph, what was refused, how far a list has come.

Asked as `/ca`, through the network face, and only while somebody looks: `look`, which a console
calls every second, begins one question at a time, at most every `PERIOD`. The graph is watched, so
that the master answers when it changes; pages get what was heard last.
"""

import contextlib
import threading
from collections.abc import Callable, Mapping
from contextlib import closing
from typing import Final

from ca.encoding import Value
from ca.errors import RevocationRefused
from ca.revocation.state import open_statement
from rossec import clock
from rossec.authority.console.records import to_value
from rossec.authority.console.views import DenialView, FactView, ListStanding
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.master_call import MasterCall
from rossec.errors import AnswerMalformed, ConfigurationError, NotDelivered
from rossec.participant.graph_view import METHOD as WATCH_GRAPH
from rossec.participant.graph_view import GraphView

STANDING: Final = "rossec.revocationStanding"
DENIALS: Final = "rossec.recentDenials"
PERIOD: Final = 2.0  # seconds between two questions
FRESH: Final = 30.0  # seconds for which what was heard is shown
SHORT: Final = 3.0  # seconds for an answer that a page waits for
LONG: Final = 15.0  # for one that the master delays until there is news
MAX_FACTS: Final = 20_000
_HINT: Final = "it is asked again"


class MasterView:
    """The operations that need the master.

    Args:
        work: of the authority.
        deliver: calls the master. Raises `NotDelivered`.
        elapsed: seconds of a clock that cannot be set.
        begin: calls a function in another thread.
        came_back: called when the master answers again: something may wait for it.
    """

    def __init__(
        self,
        work: AuthorityWork,
        deliver: Callable[[MasterCall], object],
        elapsed: clock.Seconds | None = None,
        begin: Callable[[Callable[[], None]], None] | None = None,
        came_back: Callable[[], None] = lambda: None,
    ) -> None:
        self._work = work
        self._deliver = deliver
        self._elapsed = clock.counter() if elapsed is None else elapsed
        self._begin = begin or _in_thread
        self._came_back = came_back
        self._is_away = False
        self._asking = threading.Lock()  # held by the thread that asks
        self._begun = self._heard = self._standing_asked = float("-inf")
        self._view = GraphView()
        self._denials: tuple[DenialView, ...] = ()
        self._standing: ListStanding | None = None
        self._changes = 0

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {"standing": self.standing, "graph": self.graph, "denials": self.denials}

    def look(self) -> int:
        """A number that changes when the master says something else; asks it if that is due."""
        if self._elapsed() - self._begun >= PERIOD and self._asking.acquire(blocking=False):
            self._begun = self._elapsed()
            self._begin(self._ask_and_release)
        return self._changes

    def graph(self) -> Value:
        """The graph, as it was heard last, or asked for now.

        Raises:
            NotDelivered: the master is out of reach.
        """
        if self._elapsed() - self._heard > FRESH:
            view = GraphView()
            self._watch(view, SHORT)
            return _facts(view)
        return _facts(self._view)

    def denials(self) -> Value:
        """The rights that nodes lacked in the last day, newest first.

        Raises:
            NotDelivered: the master is out of reach.
        """
        if self._elapsed() - self._heard > FRESH:
            return to_value(self._recent_denials())
        return to_value(self._denials)

    def standing(self, epoch: int, seq: int) -> Value:
        """How far a list has come; [0, 0]: that of all that was revoked until now."""
        self._standing_asked = self._elapsed()
        found = self._list_standing(epoch, seq)
        self._standing = found
        return to_value(found)

    def _ask_and_release(self) -> None:
        try:
            with contextlib.suppress(ConfigurationError, AnswerMalformed):
                self._ask()
            if self._is_away:
                self._is_away = False
                self._came_back()
        except NotDelivered:  # what was heard is old: whoever looks is told now
            self._changes += not self._is_away
            self._is_away, self._heard = True, float("-inf")
        finally:
            self._asking.release()

    def _ask(self) -> None:
        """Ask what pages are likely to show; a page with ticks is not kept waiting by the graph."""
        standing = self._standing
        if standing is not None and self._elapsed() - self._standing_asked < FRESH:
            self._note(standing, self._list_standing(standing.epoch, standing.seq))
            if self._elapsed() - self._heard < FRESH / 2:
                return
        before = self._view.facts
        self._watch(self._view, LONG)
        self._note(before, self._view.facts)
        self._heard = self._elapsed()
        with contextlib.suppress(NotDelivered):
            known, self._denials = self._denials, self._recent_denials()
            self._note(*({each[1:] for each in some} for some in (known, self._denials)))

    def _note(self, before: object, after: object) -> None:
        self._changes += before != after

    def _watch(self, view: GraphView, within: float) -> None:
        """Bring `view` up to date: further parts follow at once.

        Raises:
            NotDelivered: out of reach, or it says more than any graph has.
        """
        more = True
        while more:
            answer = self._call(
                WATCH_GRAPH, (*view.next_params,), "a question about the graph", within
            )
            more = view.take(answer).more
            if len(view.facts) > MAX_FACTS:
                raise NotDelivered(f"the graph has more than {MAX_FACTS} facts", _HINT)

    def _recent_denials(self) -> tuple[DenialView, ...]:
        answer = self._call(DENIALS, (), "a question about denials", SHORT)
        if not isinstance(answer, list):
            raise NotDelivered("the master's answer about denials is malformed", _HINT)
        return tuple(_denial(row, self._work.now()) for row in answer)

    def _list_standing(self, epoch: int, seq: int) -> ListStanding:
        home, now = self._work.home(), self._work.now()
        with closing(home.store()) as store:
            data = store.newest_list()
        newest = (0, 0)
        with contextlib.suppress(RevocationRefused):
            if data is not None:
                found = open_statement(data, home.anchor().public_key)
                newest = found.epoch, found.seq
        wanted = (epoch, seq)
        if wanted == (0, 0):
            wanted = newest if home.count_unlisted(now) == 0 else (0, 0)
        if wanted == (0, 0) or newest < wanted:
            return ListStanding(epoch, seq, False, False, 0, 0)
        return self._ask_standing(*wanted, is_published=data == self._work.published)

    def _ask_standing(self, epoch: int, seq: int, *, is_published: bool) -> ListStanding:
        """What the master says of a signed list; if it does not answer, what it took before.

        Nodes that hold a newer one than was asked for hold this one too.
        """
        unknown = ListStanding(epoch, seq, True, is_published, 0, 0)
        try:
            answer = self._call(STANDING, (), "a question about a list", SHORT)
        except NotDelivered:
            return unknown
        match answer:
            case {"list": str(number), "nodes": int(nodes), "holding": int(holding)} if (
                0 <= holding <= nodes
            ):
                is_there = _number(number) >= (epoch, seq)
                return ListStanding(epoch, seq, True, is_there, nodes, holding if is_there else 0)
            case _:
                return unknown

    def _call(self, method: str, arguments: tuple[object, ...], what: str, within: float) -> object:
        node = self._work.home().node()
        return self._deliver(
            MasterCall(node, method, arguments, what, _HINT, within=within, waits=True)
        )


def _facts(view: GraphView) -> Value:
    return to_value(tuple(FactView(*fact) for fact in sorted(view.facts)))


def _number(text: str) -> tuple[int, int]:
    """A list's number, as the master writes it; [0, 0] if it is none."""
    epoch, _, seq = text.partition(".")
    is_one = all(part.isascii() and part.isdigit() and len(part) < 20 for part in (epoch, seq))
    return (int(epoch), int(seq)) if is_one else (0, 0)


def _denial(row: object, now: int) -> DenialView:
    """One of the master's list.

    Raises:
        NotDelivered: it is none.
    """
    match row:
        case [int(ago), str(node), int(right), str(name)]:
            return DenialView(now - ago, node, right, name)
        case _:
            raise NotDelivered("the master's answer about denials is malformed", _HINT)


def _in_thread(task: Callable[[], None]) -> None:
    threading.Thread(target=task, name="questions to the master", daemon=True).start()
