"""`system.multicall`: each element is a call of its own, with its own rights. Pure.

It is processed in turns, so that four thousand elements of one node do not delay other calls; the
caller's rights are evaluated again at each turn. Limited are the number of elements, the number of
expensive ones, and the size of all answers together. Nesting is refused.
"""

import xmlrpc.client
from collections.abc import Callable, Sequence
from typing import Final

from rossec.master.api.methods import (
    DomainsChanged,
    GrantsPresented,
    MasterEvent,
    RevocationsChanged,
)
from rossec.master.api.turns import CallOutcome, TurnExpired, Work, advance
from rossec.master.rights.access_rules import RULES, Scope
from rossec.master.state.parameter_values import encoded_size
from rossec.ros.xmlrpc import BODY_LIMIT

Fault = xmlrpc.client.Fault
MULTICALL: Final = "system.multicall"
MULTICALL_LIMIT: Final = 4096  # roslaunch sets every parameter of a launch file in one
MULTICALL_QUERIES: Final = 16  # queries of the whole graph; more would be amplification
MULTICALL_ANSWER: Final = BODY_LIMIT // 4  # bytes, about
# Each of the own methods costs signatures or carries a whole list.
MULTICALL_ONCE: Final = frozenset(method for method in RULES if method.startswith("rossec."))


_RIGHTS_CHANGED: Final = (RevocationsChanged, DomainsChanged, GrantsPresented)
BeginCall = Callable[[str, Sequence[object]], CallOutcome | Work]
"""Answers one call, or begins to, or raises `Fault`."""


class Multicall:
    """One multicall: call `step` until `done`, then `answer` is its answer.

    Raises:
        Fault: the multicall is malformed or exceeds a limit.
    """

    def __init__(self, params: Sequence[object]) -> None:
        calls = params[0] if len(params) == 1 else None
        if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
            raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
        if sum(map(_is_query, calls)) > MULTICALL_QUERIES:
            raise Fault(1, f"rossec: more than {MULTICALL_QUERIES} state queries in a multicall")
        self._calls: list[object] = calls
        self._answers: list[object] = []
        self._first_index: dict[str, int] = {}  # by method, of those allowed once
        self._bytes_left = MULTICALL_ANSWER
        self._work: Work | None = None  # the element in progress

    @property
    def done(self) -> bool:
        """Whether no element is left."""
        return self._bytes_left < 0 or len(self._answers) == len(self._calls)

    @property
    def answer(self) -> object:
        """The answers so far; a fault when they are too long: the calls made remain in effect."""
        if self._bytes_left >= 0:
            return self._answers
        made = f"{len(self._answers)} of its {len(self._calls)} calls were made"
        text = "the answers of this multicall are too long"
        return Fault(1, f"rossec: {text}: {made}, ask for less at a time")

    def step(self, begin: BeginCall, expired: TurnExpired) -> tuple[MasterEvent, ...]:
        """Process elements until the turn has `expired`; returns the events to deliver."""
        events: list[MasterEvent] = []
        while not self.done:
            outcome = self._run_element(begin, expired)
            if outcome is None:
                break
            self._answers.append(outcome.answer)
            self._bytes_left -= encoded_size(outcome.answer)
            events += outcome.events
            if expired() or (events and isinstance(events[-1], _RIGHTS_CHANGED)):
                break  # its effects must come before the next element
        return tuple(events)

    def restart_element(self) -> None:
        """Discard the partial result of the element in progress."""
        self._work = None

    def _run_element(self, begin: BeginCall, expired: TurnExpired) -> CallOutcome | None:
        """Process one element; None: it is not finished."""
        try:
            begun = self._begin_next(begin) if self._work is None else self._work
            outcome = begun if isinstance(begun, CallOutcome) else advance(begun, expired)
        except Fault as fault:
            outcome = CallOutcome({"faultCode": fault.faultCode, "faultString": fault.faultString})
        else:
            if outcome is None:
                self._work = None if isinstance(begun, CallOutcome) else begun
                return None
            outcome = CallOutcome([outcome.answer], outcome.events)
        self._work = None
        return outcome

    def _begin_next(self, begin: BeginCall) -> CallOutcome | Work:
        element = self._calls[len(self._answers)]
        self._check_once(element)
        return _begin_element(element, begin)

    def _check_once(self, element: object) -> None:
        method, at = _method_of(element), len(self._answers)
        if method in MULTICALL_ONCE and self._first_index.setdefault(method, at) != at:
            raise Fault(1, f"rossec: more than one {method} in a multicall")


def _begin_element(element: object, begin: BeginCall) -> CallOutcome | Work:
    method = element.get("methodName") if isinstance(element, dict) else None
    params = element.get("params") if isinstance(element, dict) else None
    if not isinstance(method, str) or not isinstance(params, list):
        raise Fault(1, "rossec: a multicall element needs methodName and params")
    if method == MULTICALL:
        raise Fault(1, "rossec: a multicall inside a multicall")
    return begin(method, params)


def _method_of(element: object) -> str:
    method = element.get("methodName") if isinstance(element, dict) else None
    return method if isinstance(method, str) else ""


def _is_query(element: object) -> bool:
    rule = RULES.get(_method_of(element))
    return rule is not None and rule.scope is Scope.FILTERED
