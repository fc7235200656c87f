"""The Master API as one pure dispatch: arguments in, answer and events out.

The order of every call: arity, caller_id, identity, arguments (names resolved), right, handler.
Texts and defaults for what stock rosmaster refuses are stock's; what only rossec refuses answers
`[-1, "rossec: ...", <the method's default>]`, which rospy and roscpp log.
"""

import xmlrpc.client
from collections.abc import Sequence
from typing import Final, NamedTuple

from rossec.master import arguments as arg
from rossec.master.arguments import ArgumentRefused
from rossec.master.calls import (
    Administered,
    CallRefused,
    Denied,
    MasterEvent,
    Method,
    Methods,
    Reply,
    Request,
    StopMaster,
)
from rossec.master.gatekeeper import RULES, Caller, Gatekeeper, Refused, Scope
from rossec.master.graph import GraphCalls
from rossec.master.paramcalls import ParameterCalls
from rossec.master.params import SIZE_LIMIT, Parameters
from rossec.master.registry import Registry
from rossec.master.standing import Statements
from rossec.master.statementcalls import StatementCalls
from rossec.master.values import weight
from rossec.master.watching import WATCH, WatchCalls
from rossec.ros.xmlrpc import BODY_LIMIT

Fault = xmlrpc.client.Fault
MULTICALL: Final = "system.multicall"
MULTICALL_LIMIT: Final = 4096  # roslaunch sets every parameter of a launch file in one
MULTICALL_QUERIES: Final = 16  # answers over the whole graph; more in one call only amplifies
MULTICALL_ANSWER: Final = BODY_LIMIT  # bytes, about; else 4096 questions for one large parameter
MULTICALL_ONCE: Final = frozenset(  # each of these costs signatures or carries a whole list
    {
        "rossec.presentGrants", "rossec.renewGrants", "rossec.updateDelegation", WATCH,
        "rossec.revocations", "rossec.revocationsSince", "rossec.updateRevocations", "rossec.trl",
        "rossec.updateRevocationTree", "rossec.revocationProofs",
        "rossec.renewIdentity",
    }
)  # fmt: skip


class Outcome(NamedTuple):
    """What to answer and what to deliver."""

    answer: object
    events: tuple[MasterEvent, ...] = ()


class MasterApi:
    """Every method of the master.

    Args:
        name: the master's own certified name.
        uri, pid: what `getUri` and `getPid` answer.
        instance: names this run of the master.
        started: when it began, seconds since the epoch.
        parameters: what is set already.
        parameter_bytes: how much room all parameters together may take.
    """

    def __init__(
        self,
        registry: Registry,
        statements: Statements,
        *,
        name: str,
        uri: str,
        pid: int,
        instance: str = "",
        started: int = 0,
        parameters: Parameters | None = None,
        parameter_bytes: int = SIZE_LIMIT,
    ) -> None:
        self._uri = uri
        self._pid = pid
        self._gatekeeper = Gatekeeper(registry, name)
        self.watching = WatchCalls(registry, self._gatekeeper, instance)
        tree = Parameters() if parameters is None else parameters
        self.parameters = ParameterCalls(tree, registry, statements.caller_of, parameter_bytes)
        self.methods: Methods = {
            **GraphCalls(registry, self._gatekeeper).methods(),
            **self.parameters.methods(),
            **self.watching.methods(),
            **StatementCalls(statements, registry, name, started).methods(),
            **self._own_methods(),
        }

    def call(
        self,
        method: str,
        params: Sequence[object],
        caller: Caller,
        now: int,
        *,
        near: bool = True,
    ) -> Outcome:
        """Answer one call; `near`: it comes from the master's own host.

        Raises:
            Fault: no such method, or a multicall that is none.
        """
        if method == MULTICALL:
            return self._multicall(params, caller, now, near=near)
        row = self.methods.get(method)
        if row is None:
            raise Fault(1, f"<class 'Exception'>:method \"{method}\" is not supported")
        try:
            request = self._request(method, row, params, caller, now, near=near)
            reply = row.handler(request)
        except ArgumentRefused as refused:
            return Outcome([-1, str(refused), row.default])
        except Refused as refused:
            status = f"rossec: {refused}"
            denied = () if refused.wanted is None else (Denied(caller.name, *refused.wanted),)
            refusal = CallRefused(caller.title, method, status)
            return Outcome([-1, status, row.default], (refusal, *denied))
        events = reply.events
        if request.caller.thumbprint != caller.thumbprint:  # only an administrator gets so far
            what = f"calls {method} for {request.caller.name}: {reply.status}"
            events = (*events, Administered(caller.title, what))
        return Outcome([reply.code, reply.status, reply.value], events)

    def _request(
        self,
        method: str,
        row: Method,
        params: Sequence[object],
        caller: Caller,
        now: int,
        *,
        near: bool,
    ) -> Request:
        if not params:
            raise ArgumentRefused("missing required caller_id parameter")
        if len(params) != 1 + len(row.checks):
            raise ArgumentRefused("Error: bad call arity")
        caller_id = params[0]
        if not isinstance(caller_id, str):
            raise ArgumentRefused("caller_id must be a string")
        acting = self._gatekeeper.acting(method, caller, caller_id)
        checked = [check(params[at], caller_id) for at, check in enumerate(row.checks, 1)]
        request = Request(acting, (caller_id, *checked), now)
        self._gatekeeper.check(method, acting, request.arguments, near=near)
        return request

    def _multicall(
        self, params: Sequence[object], caller: Caller, now: int, *, near: bool
    ) -> Outcome:
        """Each element is a call of its own, with its own rights; nesting is refused."""
        calls = params[0] if len(params) == 1 else None
        if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
            raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
        if sum(map(_is_query, calls)) > MULTICALL_QUERIES:
            raise Fault(1, f"rossec: more than {MULTICALL_QUERIES} state queries in a multicall")
        answers: list[object] = []
        events: list[MasterEvent] = []
        seen: set[str] = set()
        room = MULTICALL_ANSWER
        for number, element in enumerate(calls, 1):
            try:
                _check_once(element, seen)
                outcome = self._element(element, caller, now, near=near)
            except Fault as fault:
                answers.append({"faultCode": fault.faultCode, "faultString": fault.faultString})
            else:
                answers.append([outcome.answer])
                events += outcome.events
            room -= weight(answers[-1])
            if room < 0:  # what was done is done: its events must go out
                return Outcome(_too_long(number, len(calls)), tuple(events))
        return Outcome(answers, tuple(events))

    def _element(self, element: object, caller: Caller, now: int, *, near: bool) -> Outcome:
        method = element.get("methodName") if isinstance(element, dict) else None
        params = element.get("params") if isinstance(element, dict) else None
        if not isinstance(method, str) or not isinstance(params, list):
            raise Fault(1, "rossec: a multicall element needs methodName and params")
        if method == MULTICALL:
            raise Fault(1, "rossec: a multicall inside a multicall")
        return self.call(method, params, caller, now, near=near)

    def _own_methods(self) -> Methods:
        return {
            "getUri": Method((), "", lambda _: Reply(self._uri)),
            "getPid": Method((), -1, lambda _: Reply(self._pid)),
            "shutdown": Method((arg.anything,), 0, self._shutdown),
        }

    def _shutdown(self, request: Request) -> Reply:
        reason = f"{request.caller.name}: {request.arguments[1]}"
        return Reply(0, "shutdown", events=(StopMaster(reason),))


def _method_of(element: object) -> str:
    method = element.get("methodName") if isinstance(element, dict) else None
    return method if isinstance(method, str) else ""


def _is_query(element: object) -> bool:
    rule = RULES.get(_method_of(element))
    return rule is not None and rule.scope is Scope.FILTERED


def _too_long(made: int, of: int) -> Fault:
    return Fault(
        1,
        f"rossec: the answers of this multicall are too long: {made} of its {of} calls were made, "
        "ask for less at a time",
    )


def _check_once(element: object, seen: set[str]) -> None:
    method = _method_of(element)
    if method in seen:
        raise Fault(1, f"rossec: more than one {method} in a multicall")
    if method in MULTICALL_ONCE:
        seen.add(method)
