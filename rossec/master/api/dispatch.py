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
from functools import partial
from typing import Final

from rossec.errors import HangUp
from rossec.master.api import arguments, graph_calls, parameter_calls, site_calls, statement_calls
from rossec.master.api import arguments as arg
from rossec.master.api import statement_calls as own
from rossec.master.api.methods import (
    Administered,
    CallDenied,
    CallerPresentedGrants,
    CallOutcome,
    CallRequest,
    Denied,
    DomainsChanged,
    MasterEvent,
    MasterTables,
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
from rossec.master.rights.access_rules import RULES, AccessControl, Scope
from rossec.master.rights.caller import AddressTaken, Caller, CertifiedPeer, Refused
from rossec.master.rights.statements import TrustState
from rossec.master.state.imports import MAX_WANTED
from rossec.master.state.parameters import encoded_size
from rossec.master.state.registry import Kind
from rossec.ros import names
from rossec.ros.xmlrpc import BODY_LIMIT

Fault = xmlrpc.client.Fault


class MasterApi:
    """Every method of the master; `instance` identifies this run, which began at `started`."""

    def __init__(
        self,
        tables: MasterTables,
        *,
        uri: str,
        pid: int,
        instance: str = "",
        started: int = 0,
        connected: Callable[[], Iterable[CertifiedPeer]] = tuple,
    ) -> None:
        self._presence = tables.graph.presence
        self._access_control = AccessControl(
            tables.graph, tables.name, tables.forwarded_ports.is_forwarded_port
        )
        self.graph = graph_calls.GraphCalls(tables, self._access_control, instance)
        self.parameters = parameter_calls.ParameterCalls(tables)
        self.sites = site_calls.SiteCalls(tables, instance, uri)
        self.methods = self._methods(statement_calls.StatementCalls(tables, started, connected), uri, pid)

    def _methods(self, statements: statement_calls.StatementCalls, uri: str, pid: int) -> Methods:
        # By name: the checks of its arguments after the caller_id, what it answers when it is refused, and
        # who answers it. Which right it needs is in `access_rules.RULES`, which has the same names.
        graph, parameters, sites = self.graph, self.parameters, self.sites
        topic, type_name, service = arg.topic("topic"), arg.type_name("topic_type"), arg.topic("service")
        api, service_api, key = (
            arg.uri("caller_api", "http"),
            arg.uri("service_api", "rosrpc"),
            arg.key("key"),
        )
        unregister_publisher = partial(graph.unregister, Kind.PUBLISHER)
        seen = arg.text("instance"), arg.number("cursor")
        relay = (
            arg.text("instance"),
            arg.number("seen"),
            arg.forwarded_ports("forwarded_ports"),
            arg.ways("ways"),
        )
        target = arg.text("domain"), arg.kind("kind"), arg.name("name")
        domain, digest, known = arg.text("domain"), arg.binary("digest"), arg.binary("known")
        presented, renewed = (
            arg.binaries("grants", own.PRESENT_LIMIT),
            arg.binaries("grants", own.RENEW_LIMIT),
        )
        entries = arg.binaries("entries", statement_calls.PROOF_LIMIT)
        deposited, asked = arg.binaries("grants", own.DEPOSIT_LIMIT), arg.binaries("grants", own.STATES_LIMIT)
        tree = arg.binary("tree"), arg.binary("entries")

        def shutdown(request: CallRequest) -> Reply:
            reason = f"{request.caller.name}: {request.arguments[1]}"
            return Reply(0, "shutdown", events=(StopMaster(reason),))

        return {
            # 1. Stock's: the graph.
            "registerPublisher": Method((topic, type_name, api), [], graph.register_publisher),
            "registerSubscriber": Method((topic, type_name, api), [], graph.register_subscriber),
            "registerService": Method((service, service_api, api), 0, graph.register_service),
            "unregisterPublisher": Method((topic, api), 0, unregister_publisher),
            "unregisterSubscriber": Method((topic, api), 0, graph.unregister_subscriber),
            "unregisterService": Method((service, service_api), 0, graph.unregister_service),
            "lookupNode": Method((arg.node("node"),), "", graph.lookup_node),
            "lookupService": Method((service,), "", graph.lookup_service),
            "getSystemState": Method((), [[], [], []], graph.system_state),
            "getTopicTypes": Method((), [], graph.topic_types),
            "getPublishedTopics": Method((arg.subgraph("subgraph"),), 0, graph.published_topics),
            "getUri": Method((), "", lambda _: Reply(uri)),
            "getPid": Method((), -1, lambda _: Reply(pid)),
            "shutdown": Method((arg.anything,), 0, shutdown),
            # 2. Stock's: parameters.
            "getParam": Method((key,), 0, parameters.get),
            "hasParam": Method((key,), False, parameters.has),
            "setParam": Method((key, arg.not_none("value")), 0, parameters.set),
            "deleteParam": Method((key,), 0, parameters.delete),
            "searchParam": Method((arg.search_key("key"),), 0, parameters.search),
            "getParamNames": Method((), [], parameters.parameter_names),
            "subscribeParam": Method((api, key), 0, parameters.subscribe),
            "unsubscribeParam": Method((api, key), 0, parameters.unsubscribe),
            # 3. Watchers, other masters, relays.
            graph_calls.WATCH: Method(seen, {}, graph.watch),
            site_calls.FOLLOW: Method((*seen, arg.patterns("wanted", MAX_WANTED)), {}, sites.follow),
            names.RELAY_FORWARDED_PORTS: Method(relay, {}, sites.poll),
            names.RELAY_TARGET: Method(target, [], sites.target),
            # 4. Grants and revocations of the own domain.
            "rossec.presentGrants": Method((presented,), 0, statements.present),
            "rossec.renewGrants": Method((renewed,), [], statements.renew_grants),
            "rossec.updateDelegation": Method((arg.binary("delegation"),), 0, statements.update_delegation),
            "rossec.revocations": Method((), [], statements.revocations),
            "rossec.revocationsSince": Method((digest,), [], statements.revocations_since),
            "rossec.updateRevocations": Method((arg.binary("list"),), 0, statements.update_revocations),
            "rossec.updateRevocationTree": Method(tree, 0, statements.update_tree),
            "rossec.revocationEntries": Method((), b"", statements.tree_entries),
            "rossec.revocationProofs": Method((entries,), [], statements.proofs),
            "rossec.trl": Method((arg.binary("query"),), b"", statements.query),
            # 5. Foreign domains.
            names.DOMAINS: Method((digest,), b"", statements.domains),
            names.UPDATE_DOMAINS: Method((arg.binary("list"),), 0, statements.update_domains),
            names.FOREIGN_REVOCATIONS: Method((domain, digest), [], statements.foreign_revocations),
            names.FOREIGN_PROOFS: Method((domain, entries), [], statements.foreign_proofs),
            # 6. What nodes and the authority leave here for each other.
            "rossec.depositGrants": Method((deposited,), [], statements.deposit),
            "rossec.deliveryStates": Method((asked,), [], statements.delivery_states),
            "rossec.fetchGrants": Method((known,), {}, statements.fetch),
            own.WATCH_GRANTS: Method((known,), {}, statements.fetch),
            names.RENEW_IDENTITY: Method((arg.binary("request"),), b"", statements.renew_identity),
            names.WATCH_RENEWALS: Method((arg.number("locked"),), {}, statements.offer_renewals),
            names.SETTLE_RENEWALS: Method((arg.settlements,), 0, statements.settle_renewals),
            own.TRUST_STATUS: Method((), {}, statements.trust_status),
            own.DENIALS: Method((), [], statements.recent_denials),
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
                raise arguments.ArgumentRefused("missing required caller_id parameter")
            if len(params) != 1 + len(entry.checks):
                raise arguments.ArgumentRefused("Error: bad call arity")
            caller_id = params[0]
            if not isinstance(caller_id, str):
                raise arguments.ArgumentRefused("caller_id must be a string")
            # 2. The node that the identity acts as.
            acting_caller = self._access_control.acting_caller(method, caller, caller_id)
            # 3. The other arguments; names are resolved.
            checked = [check(params[at], caller_id) for at, check in enumerate(entry.checks, 1)]
            request = CallRequest(acting_caller, (caller_id, *checked), now, is_local)
            # 4. The right, which depends on them.
            self._access_control.check(method, acting_caller, request.arguments, is_local=is_local)
            reply = entry.handler(request)
        except arguments.ArgumentRefused as refused:
            return CallOutcome([-1, str(refused), entry.default])
        except Refused as refused:
            return _refused(refused, method, entry, caller)
        if isinstance(reply, Reply):
            return _answered(reply, method, request, caller)
        return _in_steps(reply, method, entry, request, caller)

    def keep_views(self, thumbprints: frozenset[bytes]) -> None:
        self.graph.views.keep_only(thumbprints)
        self.sites.views.keep_only(thumbprints)


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
# Answers one call, or begins to, or raises `Fault`
BeginCall = Callable[[str, Sequence[object]], CallOutcome | Work]


class Multicall:
    """One multicall: call `step` until `done`, then `answer` is its answer."""

    # In turns, so that four thousand elements of one node do not delay other calls.
    def __init__(self, params: Sequence[object]) -> None:
        calls = params[0] if len(params) == 1 else None
        if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
            raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
        methods = [each.get("methodName") for each in calls if isinstance(each, dict)]
        rules = [RULES.get(method) for method in methods if isinstance(method, str)]
        if sum(rule is not None and rule.scope is Scope.FILTERED for rule in rules) > MULTICALL_QUERIES:
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
            try:
                begun = self._begin_next(begin) if self._work is None else self._work
                outcome = begun if isinstance(begun, CallOutcome) else advance(begun, expired)
                self._work = None
                if outcome is None:  # the turn has expired within this element
                    self._work = None if isinstance(begun, CallOutcome) else begun
                    break
                answer: object = [outcome.answer]
                events += outcome.events
            except Fault as fault:
                self._work = None
                answer = {"faultCode": fault.faultCode, "faultString": fault.faultString}
            self._answers.append(answer)
            self._bytes_left -= encoded_size(answer)
            if expired() or (events and isinstance(events[-1], _RIGHTS_CHANGED)):
                break  # its effects must come before the next element
        return tuple(events)

    def restart_element(self) -> None:
        self._work = None

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
    """Answers few calls of a revoked identity on one connection: an answer may be a whole list."""

    # Both ends of a connection may be revoked at once, as below a revoked intermediate; then no peer but
    # these two can close it, and only the master can inform them. It sends the list without a timestamp:
    # without that confirmation a node closes all its connections, even if it cannot find itself in a tree
    # (`ca.revocation.lists`).
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
                known = [
                    entry for entry in entries[: statement_calls.PROOF_LIMIT] if isinstance(entry, bytes)
                ]
                return [1, "proofs", self._statements.proofs(known)]
            case _:
                raise HangUp("the identity is revoked")
