"""What one node, or one program, has registered at the master, and what follows from a master's restart.
Pure.

Programs register once and never again, so registrations are kept to be made again, refused ones too, for when
there is a new grant. Tools, and programs before `init_node`, call with names that no certificate covers; the
master receives the node's own, and a relative name is resolved for the original caller, or it would silently
mean another key. Iterations are over a copy, made in one step: threads may share these tables.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Final, NamedTuple

from ca.errors import NameRefused
from ca.names import MAX_NAME, check_name
from rossec.errors import AnswerMalformed
from rossec.ros import names

Params = tuple[object, ...]
Call = tuple[str, Params]  # a method of the master, its parameters
Fact = tuple[str, str, str]
"""Kind, name and value, as `rossec.master.api.graph_calls` has them."""

GRACE: Final = 15.0  # seconds; a hundred nodes register within six
FIRST: Final = 0.25
FAST_PERIOD: Final = 30.0  # seconds from the loss on
_LONGEST_FAST: Final = 1.0
_LONGEST: Final = 5.0
REFUSED: Final = "rossec: "  # a status that begins so is not one of the stock master
MAX_REFUSED: Final = 256  # refused registrations of one program that are kept
WATCH_GRAPH: Final = "rossec.watchGraph"
SEARCH: Final = "searchParam"
RELATIVE_NAME: Final = {
    "registerPublisher": 1,
    "registerSubscriber": 1,
    "registerService": 1,
    "unregisterPublisher": 1,
    "unregisterSubscriber": 1,
    "unregisterService": 1,
    "lookupNode": 1,
    "lookupService": 1,
    "getPublishedTopics": 1,
    "subscribeParam": 2,
    "unsubscribeParam": 2,
    "getParam": 1,
    "setParam": 1,
    "deleteParam": 1,
    "hasParam": 1,
}
"""Index of the parameter that is a name relative to the caller; the caller_id is 0."""
UNREGISTERS: Final = {
    "unregisterPublisher": "registerPublisher",
    "unregisterSubscriber": "registerSubscriber",
    "unregisterService": "registerService",
    "unsubscribeParam": "subscribeParam",
}
REGISTERS: Final = frozenset(UNREGISTERS.values())
_ADDRESS: Final = {
    "registerPublisher": 3,
    "registerSubscriber": 3,
    "registerService": 2,
    "subscribeParam": 1,
    "unregisterPublisher": 2,
    "unregisterSubscriber": 2,
    "unregisterService": 2,
    "unsubscribeParam": 1,
}
"""Index of the address that is registered: of the service, else of the slave API."""
UNHEARD: Final = frozenset({"setParam", "deleteParam"})
"""Calls to the master whose refusal does not reach the program: rospy and roscpp drop the answer."""
GRAPH: Final = frozenset({"getSystemState", "getTopicTypes", "getPublishedTopics"})
"""Calls that are answered with what the caller may see."""


def resolve_params(method: str, params: Params, caller: str) -> Params:
    """`params` with the name in them resolved for `caller`; an empty name stays as it is."""
    index = RELATIVE_NAME.get(method, len(params))
    name = params[index] if index < len(params) else None
    if not isinstance(name, str) or not name:
        return params
    return (*params[:index], names.resolve(name, caller), *params[index + 1 :])


def searched_key(method: str, params: Params) -> str | None:
    """The key that `searchParam` looks for from the caller's namespace; None for other calls."""
    match method, params:
        case "searchParam", (_, str() as key) if key and key[0] not in "/~":
            return key
        case _:
            return None


def search_places(caller: str, key: str) -> Iterator[tuple[str, str]]:
    """Where stock looks for `key`, innermost first: names that must exist, with their results."""
    return names.search_paths(caller[:MAX_NAME], key)


def search_result(answer: list[object], found: str) -> list[object] | None:
    """The result of the search, from the answer for one name; None: go on with the next."""
    match answer:
        case [1, *_]:
            return [1, f"Found [{found}]", found]
        case [-1, str(status), _] if not status.startswith(REFUSED):
            return None
        case _:
            return answer


def not_found(key: str) -> list[object]:
    return [-1, f"Cannot find parameter [{key}] in an upwards search", ""]


class RegistrationTable:
    def __init__(self) -> None:
        self._calls: dict[tuple[str, str], tuple[object, ...]] = {}
        self._refused: set[tuple[str, str]] = set()

    def __iter__(self) -> Iterator[Call]:
        return iter([(method, params) for (method, _), params in self._calls.copy().items()])

    def refused(self) -> list[Call]:
        calls = self._calls.copy().items()
        return [(key[0], params) for key, params in calls if key in self._refused]

    def find(self, method: str, name: str) -> tuple[object, ...] | None:
        return self._calls.get((method, name))

    def record(self, method: str, params: Sequence[object], *, refused: bool = False) -> None:
        """Record a call that registers, or unregisters, what it names; others are ignored. What was
        registered with another address stays: a new program may have the old name."""
        index = _ADDRESS.get(method)
        if index is None or len(params) <= max(index, RELATIVE_NAME[method]):
            return  # the master refuses it
        registers = UNREGISTERS.get(method, method)
        key = registers, str(params[RELATIVE_NAME[method]])
        if registers == method:
            if refused and key not in self._calls and len(self._refused) >= MAX_REFUSED:
                return
            self._calls[key] = tuple(params)
            (self._refused.add if refused else self._refused.discard)(key)
        elif key in self._calls and self._calls[key][_ADDRESS[registers]] == params[index]:
            del self._calls[key]
            self._refused.discard(key)


def unheard_refusal(method: str, params: Sequence[object], answer: object) -> str | None:
    """Why a call was refused of which the program does not hear it; None: it is none of these. What rossec
    itself refuses has a reason of its own in its status, and is not meant here."""
    match answer:
        case [code, str(status), *_] if code != 1 and method in UNHEARD:
            try:
                for name in params[RELATIVE_NAME[method] :][:1]:
                    check_name(names.canonical(str(name)))
            except NameRefused as error:
                return f"{error} ({error.hint})"
            return status
        case _:
            return None


def shows_nothing(method: str, answer: object) -> bool:
    """Whether a node asked for the graph and was shown nothing of it: that looks as if there were nothing."""
    match answer:
        case [1, _, list(found)] if method in GRAPH:
            return not any(found)
        case _:
            return False


def nothing_shown(node: str) -> str:
    return f"nothing that {node} may see; all of it needs: rossec grant sign {node} --graph"


class Retry:
    """The pauses after one loss of a connection, until `succeeded`.

    Soon at first, as a restarted master is back within seconds; less often after `FAST_PERIOD`, when it was
    probably switched off. Each pause is shortened at random by up to a half, or all nodes would reconnect at
    the same moment: `rand` returns a number from 0 up to 1.
    """

    def __init__(self, rand: Callable[[], float]) -> None:
        self._rand = rand
        self.succeeded()

    def succeeded(self) -> None:
        self._pause, self._lost_at = FIRST / 2, -1.0

    def pause(self, now: float) -> float:
        """Seconds to wait after a failure at `now`."""
        if self._lost_at < 0:
            self._lost_at = now
        longest = _LONGEST_FAST if now - self._lost_at < FAST_PERIOD else _LONGEST
        self._pause = min(2 * self._pause, longest)
        return self._pause * (1 - self._rand() / 2)


class PublisherGrace:
    """The publishers to stay connected to while a restarted master receives registrations, by their URIs.

    A restarted master knows the nodes that have registered since. Subscribers that reconnect first are sent
    incomplete publisher lists, and disconnecting from the rest would interrupt topics that are not affected.
    So after a session is opened, a publisher missing from the list is kept for `GRACE` seconds, or until it
    is listed again; if it is removed after that, it is dropped at once. The grace period begins with the loss
    of the session, and not again while a publisher is missing: a peer that resets sessions cannot extend it.
    `now`: seconds of a monotonic clock.
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._listed: dict[str, tuple[str, ...]] = {}
        self._missing: dict[str, frozenset[str]] = {}  # by topic; no empty sets
        self._until = 0.0

    def session_opened(self) -> None:
        now = self._now()
        if now >= self._until:
            self._missing.clear()
        # Not while one is missing: who resets sessions could prolong it (attack `reset-sessions`).
        if not self._missing:
            self._until = now + GRACE
        listed = self._listed.copy()  # atomic: in rospy threads share it
        for topic, uris in listed.items():
            if uris:
                self._missing[topic] = self._missing.get(topic, frozenset()).union(uris)

    def update(self, topic: str, uris: Iterable[str]) -> list[str]:
        """Take the master's list; returns the publishers to connect to."""
        self._listed[topic] = named = tuple(uris)
        missing = self._missing.pop(topic, frozenset()).difference(named)
        if missing:
            self._missing[topic] = missing
        return self.to_follow(topic)

    def to_follow(self, topic: str) -> list[str]:
        """The publishers the master lists, then missing ones still in their grace period."""
        named = self._listed.get(topic, ())
        missing = self._missing.get(topic, ()) if self._now() < self._until else ()
        return [*named, *sorted(set(missing).difference(named))]

    def expired_topics(self) -> list[str]:
        """Topics with publishers missing at the end of the grace period, each returned once."""
        if self._now() < self._until:
            return []
        topics, self._missing = list(self._missing), {}
        return topics

    def forget(self, topic: str) -> None:
        self._listed.pop(topic, None)
        self._missing.pop(topic, None)


class ObservedChange(NamedTuple):
    added: tuple[Fact, ...]
    removed: tuple[Fact, ...]
    restarted: bool  # the master restarted, or no longer knows this watcher
    more: bool  # call again at once


class GraphView:
    """The graph as one watcher knows it from the answers of `rossec.watchGraph`.

    The thesis (4.2) has a watcher compare versions to notice a restarted master; here each answer has an
    instance id of the master, and a master that does not know the watcher sends the whole graph.
    """

    def __init__(self) -> None:
        self.facts: frozenset[Fact] = frozenset()
        self.version = -1
        self.instance = ""
        self._cursor = 0

    @property
    def next_params(self) -> tuple[str, int]:
        return self.instance, self._cursor

    def take(self, answer: object) -> ObservedChange:
        """Take over an answer; facts that are sent again but have not changed are not reported."""
        match answer:
            case {
                "instance": str() as instance,
                "version": int() as version,
                "cursor": int() as cursor,
                "whole": bool() as whole,
                "more": bool() as more,
                "added": list() as added,
                "removed": list() as removed,
            }:
                new, old = facts_of(added), facts_of(removed)
            case _:
                raise AnswerMalformed("a graph update that is malformed")
        known = self.facts
        self.facts = ((frozenset() if whole else known) | new) - old
        restarted = whole and self.instance != ""
        self.instance, self.version, self._cursor = instance, version, cursor
        return ObservedChange(
            tuple(sorted(self.facts - known)), tuple(sorted(known - self.facts)), restarted, more
        )


def facts_of(rows: list[object]) -> frozenset[Fact]:
    found: set[Fact] = set()
    for row in rows:
        match row:
            case [str() as kind, str() as name, str() as value]:
                found.add((kind, name, value))
            case _:
                raise AnswerMalformed("a graph update that is malformed")
    return frozenset(found)
