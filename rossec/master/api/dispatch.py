"""The Master API as one pure dispatch: arguments in, answer and events out.

What stock rosmaster refuses is answered with its texts and defaults; what only rossec refuses with
`[-1, "rossec: ...", <the method's default>]`, which rospy and roscpp log. Each element of a
`system.multicall` is a call of its own, with its own rights, evaluated again at each turn. A
revoked identity is answered the revocations only.
"""

import xmlrpc
import xmlrpc.client
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Final

from rossec.errors import HangUp
from rossec.master.api import arguments as arg
from rossec.master.api.arguments import ArgumentRefused
from rossec.master.api.graph_calls import GraphCalls, WatchCalls
from rossec.master.api.methods import (
    Administered,
    CallDenied,
    CallerPresentedGrants,
    CallOutcome,
    CallRequest,
    Denied,
    DomainsChanged,
    MasterEvent,
    Method,
    Methods,
    Reply,
    RevocationsChanged,
    Steps,
    StopMaster,
    TurnExpired,
    Work,
    advance,
)
from rossec.master.api.parameter_calls import ParameterCalls
from rossec.master.api.site_calls import RelayCalls, SiteCalls
from rossec.master.api.statement_calls import (
    PROOF_LIMIT,
    AuthorityCalls,
    DepositCalls,
    DomainCalls,
    RenewalCalls,
    StatementCalls,
)
from rossec.master.rights.access_rules import RULES, AccessControl, Scope
from rossec.master.rights.caller import AddressTaken, Caller, CertifiedPeer, RecentDenials, Refused
from rossec.master.rights.held_grants import Deposits
from rossec.master.rights.publisher_views import AliasPublishers
from rossec.master.rights.statements import TrustState
from rossec.master.state.forwarded_ports import ForwardedPorts
from rossec.master.state.graph import Graph
from rossec.master.state.imports import Imports
from rossec.master.state.parameters import SIZE_LIMIT, Parameters, encoded_size
from rossec.master.state.registry import Registry
from rossec.ros.xmlrpc import BODY_LIMIT

Fault = xmlrpc.client.Fault


class MasterApi:
    """Every method of the master; `instance` identifies this run, which began at `started`.

    By default no deposit is accepted and nothing imported; `aliases` is of the same registry and imports.
    """

    def __init__(
        self,
        registry: Registry,
        statements: TrustState,
        *,
        name: str,
        uri: str,
        pid: int,
        instance: str = "",
        started: int = 0,
        parameters: Parameters | None = None,
        parameter_bytes: int = SIZE_LIMIT,
        deposits: Deposits | None = None,
        denials: RecentDenials | None = None,
        connected: Callable[[], Iterable[CertifiedPeer]] = tuple,
        imports: Imports | None = None,
        doors: ForwardedPorts | None = None,
        aliases: AliasPublishers | None = None,
    ) -> None:
        imports = Imports(registry) if imports is None else imports
        if aliases is None:
            aliases = AliasPublishers(Graph(registry, imports), statements.caller_of)
        graph, self._presence = aliases.graph, aliases.graph.presence
        doors = ForwardedPorts() if doors is None else doors
        self._access_control = AccessControl(graph, name, doors.is_door)
        self.watch_calls = WatchCalls(graph, self._access_control, instance)
        self.site_calls = SiteCalls(registry, instance, statements.list_digests)
        tree = Parameters() if parameters is None else parameters
        deposits = Deposits() if deposits is None else deposits
        denials = RecentDenials() if denials is None else denials
        self.parameters = ParameterCalls(
            tree, registry, statements.caller_of, parameter_bytes, imports.mirrors
        )
        self.methods: Methods = {
            **GraphCalls(graph, self._access_control, aliases).methods(),
            **self.parameters.methods(),
            **self.watch_calls.methods(),
            **self.site_calls.methods(),
            **StatementCalls(statements, registry, name, started, deposits).methods(),
            **DomainCalls(statements).methods(),
            **RenewalCalls(statements).methods(),
            **RelayCalls(doors, registry, statements, name, uri).methods(),
            **DepositCalls(statements, deposits).methods(),
            **AuthorityCalls(statements, denials, connected).methods(),
            "getUri": Method((), "", lambda _: Reply(uri)),
            "getPid": Method((), -1, lambda _: Reply(pid)),
            "shutdown": Method((arg.anything,), 0, _shutdown),
        }

    def begin(
        self, method: str, params: Sequence[object], caller: Caller, now: int, *, is_local: bool = True
    ) -> CallOutcome | Work:
        """Answer one call, or begin to; `is_local`: the caller is on the master's host."""
        entry = self.methods.get(method)
        if entry is None:
            raise Fault(1, f"<class 'Exception'>:method \"{method}\" is not supported")
        self._presence.now = now
        try:
            # 1. Arity and caller_id.
            if not params:
                raise ArgumentRefused("missing required caller_id parameter")
            if len(params) != 1 + len(entry.checks):
                raise ArgumentRefused("Error: bad call arity")
            caller_id = params[0]
            if not isinstance(caller_id, str):
                raise ArgumentRefused("caller_id must be a string")
            # 2. The node that the identity acts as.
            acting_caller = self._access_control.acting_caller(method, caller, caller_id)
            # 3. The other arguments; names are resolved.
            checked = [check(params[at], caller_id) for at, check in enumerate(entry.checks, 1)]
            request = CallRequest(acting_caller, (caller_id, *checked), now, is_local)
            # 4. The right, which depends on them.
            self._access_control.check(method, acting_caller, request.arguments, is_local=is_local)
            reply = entry.handler(request)
        except ArgumentRefused as refused:
            return CallOutcome([-1, str(refused), entry.default])
        except Refused as refused:
            return _refused(refused, method, entry, caller)
        if isinstance(reply, Reply):
            return _answered(reply, method, request, caller)
        return _in_steps(reply, method, entry, request, caller)

    def keep_views(self, thumbprints: frozenset[bytes]) -> None:
        self.watch_calls.views.keep_only(thumbprints)
        self.site_calls.views.keep_only(thumbprints)


def _shutdown(request: CallRequest) -> Reply:
    reason = f"{request.caller.name}: {request.arguments[1]}"
    return Reply(0, "shutdown", events=(StopMaster(reason),))


def _in_steps(steps: Steps, method: str, entry: Method, request: CallRequest, caller: Caller) -> Work:
    try:
        reply = yield from steps
    except Refused as refused:
        return _refused(refused, method, entry, caller)
    return _answered(reply, method, request, caller)


def _answered(reply: Reply, method: str, request: CallRequest, caller: Caller) -> CallOutcome:
    events = reply.events
    if request.caller.thumbprint != caller.thumbprint:  # only an administrator passes the checks
        what = f"calls {method} for {request.caller.name}: {reply.status}"
        events = (*events, Administered(caller.display_name, what))
    return CallOutcome([reply.code, reply.status, reply.value], events)


def _refused(refused: Refused, method: str, entry: Method, caller: Caller) -> CallOutcome:
    status = f"rossec: {refused}"
    denied = () if refused.missing is None else (Denied(caller.name, *refused.missing),)
    taken_by = refused.owner if isinstance(refused, AddressTaken) else None
    refusal = CallDenied(
        caller.display_name, method, status, taken_by, refused.missing, caller.name, caller.wildcard
    )
    return CallOutcome([-1, status, entry.default], (refusal, *denied))


MULTICALL: Final = "system.multicall"
MULTICALL_LIMIT: Final = 4096  # roslaunch sets every parameter of a launch file in one
MULTICALL_QUERIES: Final = 16  # queries of the whole graph; more would be amplification
MULTICALL_ANSWER: Final = BODY_LIMIT // 4  # bytes, about
# Each of the own methods costs signatures or carries a whole list.
MULTICALL_ONCE: Final = frozenset(method for method in RULES if method.startswith("rossec."))


_RIGHTS_CHANGED: Final = (RevocationsChanged, DomainsChanged, CallerPresentedGrants)
BeginCall = Callable[[str, Sequence[object]], CallOutcome | Work]
"""Answers one call, or begins to, or raises `Fault`."""


class Multicall:
    """One multicall: call `step` until `done`, then `answer` is its answer.

    In turns, so that four thousand elements of one node do not delay other calls.
    """

    def __init__(self, params: Sequence[object]) -> None:
        calls = params[0] if len(params) == 1 else None
        if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
            raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
        if sum(map(_is_query, calls)) > MULTICALL_QUERIES:
            raise Fault(1, f"rossec: more than {MULTICALL_QUERIES} state queries in a multicall")
        self._calls: list[object] = calls
        self._answers: list[object] = []
        self._first: dict[str, int] = {}  # by method, of those allowed once
        self._bytes_left = MULTICALL_ANSWER
        self._work: Work | None = None  # the element in progress

    @property
    def done(self) -> bool:
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
        self._work = None

    def _run_element(self, begin: BeginCall, expired: TurnExpired) -> CallOutcome | None:
        # Process one element; None: it is not finished.
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
        at = len(self._answers)
        found = self._calls[at]
        element = found if isinstance(found, dict) else {}
        method, params = element.get("methodName"), element.get("params")
        if isinstance(method, str) and method in MULTICALL_ONCE and self._first.setdefault(method, at) != at:
            raise Fault(1, f"rossec: more than one {method} in a multicall")
        if not isinstance(method, str) or not isinstance(params, list):
            raise Fault(1, "rossec: a multicall element needs methodName and params")
        if method == MULTICALL:
            raise Fault(1, "rossec: a multicall inside a multicall")
        return begin(method, params)


def _is_query(element: object) -> bool:
    method = element.get("methodName") if isinstance(element, dict) else None
    rule = RULES.get(method) if isinstance(method, str) else None
    return rule is not None and rule.scope is Scope.FILTERED


CONNECTION_SECONDS: Final = 5.0  # seconds that a connection of a revoked identity may last
MAX_CONNECTIONS: Final = 4  # such connections of one identity
MAX_BELOW_INTERMEDIATE: Final = 32  # of all identities below one intermediate
MAX_CALLS: Final = 16  # on one connection; a node makes two or three
_LIST_METHODS: Final = frozenset({"rossec.revocations", "rossec.revocationsSince"})
_UNCONFIRMED: Final = b""


class RevokedConnections:
    def __init__(self) -> None:
        self._counts: Counter[bytes] = Counter()

    def admit(self, keys: tuple[bytes, ...]) -> bool:
        """Count one more of the identity with these keys, its own first; False: too many."""
        own, *issuers = keys
        full = self._counts[own] >= MAX_CONNECTIONS or any(
            self._counts[key] >= MAX_BELOW_INTERMEDIATE for key in issuers
        )
        if not full:
            self._counts.update(keys)
        return not full

    def release(self, keys: tuple[bytes, ...]) -> None:
        self._counts -= Counter(keys)  # drops zeros


class RevokedCalls:
    """Answers few calls of a revoked identity on one connection: an answer may be a whole list.

    Both ends of a connection may be revoked at once, as below a revoked intermediate; then no peer
    but these two can close it, and only the master can inform them. It sends the list without a
    timestamp: without that confirmation a node closes all its connections, even if it cannot find
    itself in a tree (`ca.revocation.lists`).
    """

    def __init__(self, statements: TrustState, now: Callable[[], int]) -> None:
        self._statements = statements
        self._now = now
        self._calls_left = MAX_CALLS

    def answer(self, method: str, params: tuple[object, ...], _: object) -> list[object]:
        self._calls_left -= 1
        if self._calls_left < 0:
            raise HangUp("the identity is revoked, and has been sent the list")
        match params:
            case (str(), *_) if method in _LIST_METHODS:
                # Always whole: an empty list would mean that there is none.
                return [1, "revocations", [self._statements.current(self._now())[0], _UNCONFIRMED]]
            case (str(), list() as entries) if method == "rossec.revocationProofs":
                known = [entry for entry in entries[:PROOF_LIMIT] if isinstance(entry, bytes)]
                return [1, "proofs", self._statements.proofs(known)]
            case _:
                raise HangUp("the identity is revoked")
