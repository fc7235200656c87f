"""`system.multicall`: each element is a call of its own, with its own rights. Pure.

Some elements are made at a time, so that one node with four thousand does not keep the others
waiting; what the caller may do is asked anew each time. What is bounded: the elements, those that
cost much, and how long all answers are together. Nesting is refused.
"""

import xmlrpc.client
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple

from rossec.master.calls import GrantsPresented, MasterEvent, RevocationsChanged
from rossec.master.gatekeeper import RULES, Scope
from rossec.master.values import weight
from rossec.ros.xmlrpc import BODY_LIMIT

Fault = xmlrpc.client.Fault
MULTICALL: Final = "system.multicall"
MULTICALL_LIMIT: Final = 4096  # roslaunch sets every parameter of a launch file in one
MULTICALL_QUERIES: Final = 16  # answers over the whole graph; more in one call only amplifies
MULTICALL_ANSWER: Final = BODY_LIMIT  # bytes, about; else 4096 questions for one large parameter
BATCH: Final = 64  # elements made before others have their turn
MULTICALL_ONCE: Final = frozenset(  # each of these costs signatures or carries a whole list
    {
        "rossec.presentGrants", "rossec.renewGrants", "rossec.updateDelegation",
        "rossec.revocations", "rossec.revocationsSince", "rossec.updateRevocations", "rossec.trl",
        "rossec.updateRevocationTree", "rossec.revocationProofs", "rossec.renewIdentity",
        "rossec.watchGraph",
    }
)  # fmt: skip


class Outcome(NamedTuple):
    """What to answer and what to deliver."""

    answer: object
    events: tuple[MasterEvent, ...] = ()


_RIGHTS: Final = (RevocationsChanged, GrantsPresented)
Make = Callable[[str, Sequence[object]], Outcome]
"""Makes one call, or raises `Fault`."""


class Multicall:
    """One multicall: `step` until `done`, then `answer` is what to answer.

    Raises:
        Fault: it is none, or asks for too much.
    """

    def __init__(self, params: Sequence[object]) -> None:
        calls = params[0] if len(params) == 1 else None
        if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
            raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
        if sum(map(_is_query, calls)) > MULTICALL_QUERIES:
            raise Fault(1, f"rossec: more than {MULTICALL_QUERIES} state queries in a multicall")
        self._calls: list[object] = calls
        self._answers: list[object] = []
        self._seen: set[str] = set()
        self._room = MULTICALL_ANSWER

    @property
    def done(self) -> bool:
        """Whether nothing is left to be made."""
        return self._room < 0 or len(self._answers) == len(self._calls)

    @property
    def answer(self) -> object:
        """The answers made so far; a fault when they are too long, though what was made is made."""
        if self._room >= 0:
            return self._answers
        made = f"{len(self._answers)} of its {len(self._calls)} calls were made"
        text = "the answers of this multicall are too long"
        return Fault(1, f"rossec: {text}: {made}, ask for less at a time")

    def step(self, make: Make) -> tuple[MasterEvent, ...]:
        """Make some more of the calls; returns what is to be delivered for them."""
        events: list[MasterEvent] = []
        begun = len(self._answers)
        for element in self._calls[begun : begun + BATCH]:
            try:
                self._check_once(element)
                outcome = _made(element, make)
            except Fault as fault:
                answer: object = {"faultCode": fault.faultCode, "faultString": fault.faultString}
            else:
                answer = [outcome.answer]
                events += outcome.events
            self._answers.append(answer)
            self._room -= weight(answer)
            if self._room < 0 or (events and isinstance(events[-1], _RIGHTS)):
                break  # what follows from it must have followed before the next one is made
        return tuple(events)

    def _check_once(self, element: object) -> None:
        method = _method_of(element)
        if method in self._seen:
            raise Fault(1, f"rossec: more than one {method} in a multicall")
        if method in MULTICALL_ONCE:
            self._seen.add(method)


def _made(element: object, make: Make) -> Outcome:
    method = element.get("methodName") if isinstance(element, dict) else None
    params = element.get("params") if isinstance(element, dict) else None
    if not isinstance(method, str) or not isinstance(params, list):
        raise Fault(1, "rossec: a multicall element needs methodName and params")
    if method == MULTICALL:
        raise Fault(1, "rossec: a multicall inside a multicall")
    return make(method, params)


def _method_of(element: object) -> str:
    method = element.get("methodName") if isinstance(element, dict) else None
    return method if isinstance(method, str) else ""


def _is_query(element: object) -> bool:
    rule = RULES.get(_method_of(element))
    return rule is not None and rule.scope is Scope.FILTERED
