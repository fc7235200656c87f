"""The Master API as one pure dispatch: arguments in, answer and events out.

The order of every call: arity, caller_id, identity, arguments (names resolved), right, handler.
What stock rosmaster refuses is answered with its texts and defaults; what only rossec refuses with
`[-1, "rossec: ...", <the method's default>]`, which rospy and roscpp log.
"""

import xmlrpc.client
from collections.abc import Callable, Iterable, Sequence

from rossec.master.api import arguments as arg
from rossec.master.api.arguments import ArgumentRefused
from rossec.master.api.authority_calls import AuthorityCalls
from rossec.master.api.deposit_calls import DepositCalls
from rossec.master.api.domain_calls import DomainCalls
from rossec.master.api.graph_calls import GraphCalls
from rossec.master.api.methods import (
    Administered,
    CallDenied,
    CallRequest,
    Denied,
    Method,
    Methods,
    Reply,
    Steps,
    StopMaster,
)
from rossec.master.api.parameter_calls import ParameterCalls
from rossec.master.api.relay_calls import RelayCalls
from rossec.master.api.renewal_calls import RenewalCalls
from rossec.master.api.site_calls import SiteCalls
from rossec.master.api.statement_calls import StatementCalls
from rossec.master.api.turns import CallOutcome, Work
from rossec.master.api.watch_calls import WatchCalls
from rossec.master.rights.access_rules import AccessControl
from rossec.master.rights.alias_publishers import AliasPublishers
from rossec.master.rights.caller import AddressTaken, Caller, Peer, Refused
from rossec.master.rights.deposits import Deposits
from rossec.master.rights.recent_denials import RecentDenials
from rossec.master.rights.statements import TrustState
from rossec.master.state.doors import Doors
from rossec.master.state.graph import Graph
from rossec.master.state.imports import Imports
from rossec.master.state.parameters import SIZE_LIMIT, Parameters
from rossec.master.state.registry import Registry

Fault = xmlrpc.client.Fault


class MasterApi:
    """Every method of the master.

    Args:
        name: the master's own certified name.
        uri, pid: what `getUri` and `getPid` answer.
        instance: identifies this run of the master.
        started: when this run began, seconds since the epoch.
        parameters: those already set.
        parameter_bytes: limit on the size of all parameters together.
        deposits: the grants deposited so far; by default none is accepted.
        denials: which rights nodes lacked.
        connected: the identities that have a connection now.
        imports: what other masters have registered; by default nothing.
        aliases: what each subscriber of an alias is told; of the same registry and imports.
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
        connected: Callable[[], Iterable[Peer]] = tuple,
        imports: Imports | None = None,
        doors: Doors | None = None,
        aliases: AliasPublishers | None = None,
    ) -> None:
        self._uri = uri
        self._pid = pid
        imports = Imports(registry) if imports is None else imports
        if aliases is None:
            aliases = AliasPublishers(Graph(registry, imports), statements.caller_of)
        graph, self._presence = aliases.graph, aliases.graph.presence
        doors = Doors() if doors is None else doors
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
            **self._own_methods(),
        }

    def begin(
        self,
        method: str,
        params: Sequence[object],
        caller: Caller,
        now: int,
        *,
        is_local: bool = True,
    ) -> CallOutcome | Work:
        """Answer one call, or begin to; `is_local`: the caller is on the master's host.

        Raises:
            Fault: no such method.
        """
        entry = self.methods.get(method)
        if entry is None:
            raise Fault(1, f"<class 'Exception'>:method \"{method}\" is not supported")
        self._presence.now = now
        try:
            request = self._request(method, entry, params, caller, now, is_local=is_local)
            reply = entry.handler(request)
        except ArgumentRefused as refused:
            return CallOutcome([-1, str(refused), entry.default])
        except Refused as refused:
            return _refused(refused, method, entry, caller)
        if isinstance(reply, Reply):
            return _answered(reply, method, request, caller)
        return _in_steps(reply, method, entry, request, caller)

    def _request(
        self,
        method: str,
        entry: Method,
        params: Sequence[object],
        caller: Caller,
        now: int,
        *,
        is_local: bool,
    ) -> CallRequest:
        if not params:
            raise ArgumentRefused("missing required caller_id parameter")
        if len(params) != 1 + len(entry.checks):
            raise ArgumentRefused("Error: bad call arity")
        caller_id = params[0]
        if not isinstance(caller_id, str):
            raise ArgumentRefused("caller_id must be a string")
        acting_caller = self._access_control.acting_caller(method, caller, caller_id)
        checked = [check(params[at], caller_id) for at, check in enumerate(entry.checks, 1)]
        request = CallRequest(acting_caller, (caller_id, *checked), now, is_local)
        self._access_control.check(method, acting_caller, request.arguments, is_local=is_local)
        return request

    def keep_views(self, thumbprints: frozenset[bytes]) -> None:
        """Discard what was sent to all other keys."""
        self.watch_calls.views.keep_only(thumbprints)
        self.site_calls.views.keep_only(thumbprints)

    def _own_methods(self) -> Methods:
        return {
            "getUri": Method((), "", lambda _: Reply(self._uri)),
            "getPid": Method((), -1, lambda _: Reply(self._pid)),
            "shutdown": Method((arg.anything,), 0, self._shutdown),
        }

    def _shutdown(self, request: CallRequest) -> Reply:
        reason = f"{request.caller.name}: {request.arguments[1]}"
        return Reply(0, "shutdown", events=(StopMaster(reason),))


def _in_steps(
    steps: Steps, method: str, entry: Method, request: CallRequest, caller: Caller
) -> Work:
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
        caller.display_name, method, status, taken_by, refused.missing,
        caller.name, caller.wildcard,
    )  # fmt: skip
    return CallOutcome([-1, status, entry.default], (refusal, *denied))
