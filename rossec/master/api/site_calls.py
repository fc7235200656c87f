"""The calls of other masters and of the own relays. Pure (docs/spec/multimaster.md).

`rossec.followSite` is answered with what is registered at this master itself, never with what is
imported: a fact travels one hop, so no loop can arise. A master of the own domain is shown every fact, as it
is trusted for addresses; anybody else what it has `graph` on, a foreigner only what is exported to its
domain. A relay connects for another site to what `rossec.relayTarget` answers and to nothing else: what is
registered here and shown to that site's domain. A name that is unknown and one that is not shown are refused
alike, as the other relay may ask for any.
"""

import hashlib
from collections.abc import Iterator, Sequence
from typing import Final

from ca.names import is_alias, is_in_gateway
from grants.decision import Reach
from grants.model import ALL_RIGHTS, Permission, Right
from rossec.master.api.graph_calls import Fact, GraphViews
from rossec.master.api.methods import CallRequest, MasterTables, Reply, Steps, collected
from rossec.master.rights.caller import Caller, Refused
from rossec.master.state.forwarded_ports import MASTER, NODE, RelayReport
from rossec.master.state.registry import ANY_TYPE, Endpoint, Kind, Registry, endpoint, is_loopback_host

FOLLOW: Final = "rossec.followSite"
MAX_PATTERNS: Final = 64  # wanted, with a wildcard before their end: each costs with each name

# The answer after a wait without a change; short, as there are many in a silent mesh
UNCHANGED: Final[tuple[int, str, dict[str, object]]] = (1, "", {})
_KINDS: Final = (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)
_UNREACHABLE: Final = (
    "a relay on another host than the master needs forwarded ports that others reach:"
    " rossec relay --bind ADDRESS"
)
_ANOTHER: Final = (
    "another relay with this name has come since: end one of them, "
    "or give it a name of its own (rossec relay --name /relay/attic)"
)
_ON_THIS_HOST: Final = (
    "this is registered at a loopback address, and the relay is on another host: "
    "set ROS_IP or ROS_HOSTNAME where it runs"
)


class SiteCalls:
    """Handlers over what is registered here, for other masters and for relays of the own domain."""

    def __init__(self, tables: MasterTables, instance: str, uri: str) -> None:
        self._registry = tables.registry
        self._trust = tables.trust
        self._forwarded_ports = tables.forwarded_ports
        self._own = tables.name, uri
        self.views: Final = GraphViews(instance)

    def follow(self, request: CallRequest) -> Steps:
        return self._followed(request, _wanted(request.arguments[3]))

    def _followed(self, request: CallRequest, wanted: Reach | None) -> Steps:
        found = own_facts(self._registry, request.caller, wanted)
        seen = yield from collected(found, request.caller.names_per_yield)
        known = request.arguments[1], request.arguments[2]
        key, version = request.caller.thumbprint, self._registry.version
        revocations, domains = self._trust.list_digests()
        lists = revocations, b"" if request.caller.is_foreign else domains
        # an answer to other wants is one at once: the follower waits for it, also if it is no
        beside = (*lists, hashlib.sha256(repr(request.arguments[3]).encode()).digest())
        answer = self.views.answer(key, known, frozenset(seen), version, beside)
        answer |= {"revocations": lists[0], "domains": lists[1]}
        return Reply(answer, "facts of this site")

    def poll(self, request: CallRequest) -> Reply:
        _, instance, seen, forwarded_ports, ways = request.arguments
        if not (isinstance(seen, int) and isinstance(forwarded_ports, dict) and isinstance(ways, dict)):
            raise TypeError("a relay's call whose arguments were not checked")
        report = RelayReport(str(instance), seen, forwarded_ports, ways)
        for forwarded_port in report.forwarded_ports.values():
            if is_loopback_host(forwarded_port.host) and not request.is_local:
                raise Refused(_UNREACHABLE)
        if not self._forwarded_ports.has_room_for(request.caller.name):
            raise Refused("this master has too many relays")
        if self._forwarded_ports.is_superseded(request.caller.name, report.instance):
            raise Refused(_ANOTHER)
        change = self._forwarded_ports.hear(request.caller.name, report, request.now)
        answer = {
            "version": change.version,
            "wanted": [list(target) for target in change.wanted],
            "unwanted": [list(target) for target in change.unwanted],
            "masters": dict(self._forwarded_ports.masters()),
        }
        return Reply(answer, "forwarded_ports")

    def target(self, request: CallRequest) -> Reply:
        domain, kind, name = map(request.text, (1, 2, 3))
        exported: Reach | None = None
        if domain:
            domains = self._trust.domains
            listed = domains.anchors.listed(domain)
            if listed is None or request.now >= listed.entry.until:
                raise Refused(f"no domain is called {domain[:32]!a} here")
            exported = domains.exported(listed.entry.domain)
        place = self._place(kind, name, exported)
        if place is None or place[1] is None:
            raise Refused(f"no {kind} {name} is shown there")
        if is_loopback_host(place[0]) and not request.is_local:
            raise Refused(_ON_THIS_HOST)
        return Reply([*place], "target")

    def _place(self, kind: str, name: str, exported: Reach | None) -> Endpoint | None:
        own_name, own_uri = self._own
        if kind == MASTER:
            return endpoint(own_uri) if name == own_name else None
        if kind == NODE:
            node = self._registry.node(name)
            if node is None or is_alias(name):
                return None
            keys = (key for kind in _KINDS for key in self._registry.keys_of(name, kind))
            shown = _shows(exported, name) or any(_shows(exported, key) for key in keys)
            return endpoint(node.uri) if shown else None
        uri, providers = self._registry.service_uri(name), self._registry.registered_nodes(Kind.SERVICE, name)
        is_own = any(not is_alias(node.name) for node in providers)
        return endpoint(uri) if uri and is_own and _shows(exported, name) else None


def own_facts(registry: Registry, caller: Caller, wanted: Reach | None) -> Iterator[Fact | None]:
    # The facts registered here that `caller` may see and wants. None for each name that is not shown.
    # `wanted` None: everything.
    nodes = set[str]()
    for kind in _KINDS:
        for key, names in registry.entries(kind):
            own = [name for name in names if not is_alias(name)]
            if is_in_gateway(key):
                silent = registry.silent_names
                own = [name for name in own if name not in silent]
            if not own or not _is_shown(caller, wanted, key):
                yield None
                continue
            nodes.update(own)
            yield from ((kind.value, key, name) for name in own)
            if kind is Kind.SERVICE:
                yield "provider", key, registry.service_uri(key) or ""
            elif registry.topic_type(key) != ANY_TYPE:
                yield "type", key, registry.topic_type(key)
    for node in tuple(registry.nodes()):
        shown = node.name in nodes or _is_shown(caller, wanted, node.name)
        yield ("node", node.name, node.uri) if shown else None


def _is_shown(caller: Caller, wanted: Reach | None, name: str) -> bool:
    # An alias is not shown: it is a name of another origin.
    if is_alias(name) or (wanted is not None and not wanted.covers(Right.GRAPH, name)):
        return False
    exported = caller.exported is None or caller.exported.covers_any(ALL_RIGHTS, name)
    return exported and caller.may(Right.GRAPH, name)


def _wanted(value: object) -> Reach | None:
    names: Sequence[object] = value if isinstance(value, list) else ()
    if not names:
        return None
    given = [Permission(name, Right.GRAPH) for name in names if isinstance(name, str) and name]
    reach = Reach(given)
    if reach.patterns(Right.GRAPH) > MAX_PATTERNS:
        raise Refused(
            f"more than {MAX_PATTERNS} wanted patterns have a wildcard before their end: "
            "want everything, with an empty list"
        )
    return reach


def is_idle(answer: object) -> bool:
    """Whether an answer to a poll tells a relay of nothing, so that it may wait."""
    match answer:
        case [1, str(), {"wanted": [], "unwanted": []}]:
            return True
        case _:
            return False


def _shows(exported: Reach | None, name: str) -> bool:
    return exported is None or exported.covers_any(ALL_RIGHTS, name)
