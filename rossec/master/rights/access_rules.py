"""Which right each master call needs, and what a caller may see. Pure, default deny.

The table is the whole policy of the master: a method that is not in it is refused. Rights come from grants;
which of them are valid now is decided before (`held_grants`). A refusal names the missing right and does not
reveal whether the name exists: for a caller that may not see a name, the answer is the same as if it did not
exist.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError, NameRefused
from ca.names import (
    GATEWAY,
    is_alias,
    is_gateway,
    is_in_gateway,
    is_relay_name,
    served_name,
    shown,
    split_alias,
)
from grants.model import Right
from rossec.master.rights.caller import OWN_DOMAIN, AddressTaken, Caller, Refused
from rossec.master.state.graph import Graph
from rossec.master.state.registry import (
    REGISTRATIONS_LIMIT,
    Endpoint,
    Kind,
    NodeRef,
    Registry,
    endpoint,
    is_loopback_host,
    is_reachable_from_here,
)
from rossec.peer_limits import printable
from rossec.ros import names
from rossec.ros.names import AUTHORITY

MAX_GATEWAYS: Final = 64  # registered at one master; each costs a connection
_OFFERED: Final = Right.PUBLISH | Right.PROVIDE
_NOT_OFFERED: Final = (
    "{} is a name of another master: what is below /remote is subscribed, called and read here "
    "(publish or provide it under a name of this domain; other masters see that)"
)


class Scope(Enum):
    """What a call reaches beyond the right in its rule."""

    NAMED = "one name, an argument"
    TREE = "a parameter and all its descendants"
    OWN = "only registrations of the caller itself"
    FILTERED = "the whole graph, filtered by what the caller may see"
    MASTER = "the master itself"
    AUTHORITY = "the authority's own node alone"
    MEMBER = "nodes of the own domain; no right is needed"
    RELAY = "relays of the own domain; no right is needed"
    OPEN = "no right is needed"


@dataclass(frozen=True)
class AccessRule:
    """What a method needs."""

    scope: Scope  # what the call reaches
    # the right needed on the argument at `name` (or, for MASTER, on the master's name)
    right: Right | None = None
    name: int = 1  # index of that argument, counted from the caller_id
    api: int | None = None  # index of the caller's slave API URI, which must not be another node's
    service: int | None = None  # index of the URI of a service it provides


RULES: Final[Mapping[str, AccessRule]] = {
    "registerPublisher": AccessRule(Scope.NAMED, Right.PUBLISH, api=3),
    "registerSubscriber": AccessRule(Scope.NAMED, Right.SUBSCRIBE, api=3),
    "registerService": AccessRule(Scope.NAMED, Right.PROVIDE, api=3, service=2),
    "unregisterPublisher": AccessRule(Scope.OWN),
    "unregisterSubscriber": AccessRule(Scope.OWN),
    "unregisterService": AccessRule(Scope.OWN),
    "lookupService": AccessRule(Scope.NAMED, Right.CALL),
    "lookupNode": AccessRule(Scope.FILTERED),
    "getSystemState": AccessRule(Scope.FILTERED),
    "getTopicTypes": AccessRule(Scope.FILTERED),
    "getPublishedTopics": AccessRule(Scope.FILTERED),
    "getUri": AccessRule(Scope.OPEN),
    "getPid": AccessRule(Scope.OPEN),  # roscpp calls it to check whether the master is alive
    "shutdown": AccessRule(Scope.MASTER, Right.ADMIN),
    "getParam": AccessRule(Scope.TREE, Right.PARAM_GET),
    "hasParam": AccessRule(Scope.TREE, Right.PARAM_GET),
    "subscribeParam": AccessRule(Scope.TREE, Right.PARAM_GET, name=2, api=1),
    "unsubscribeParam": AccessRule(Scope.OWN),
    "searchParam": AccessRule(Scope.FILTERED),
    "getParamNames": AccessRule(Scope.FILTERED),
    "setParam": AccessRule(Scope.TREE, Right.PARAM_SET),
    "deleteParam": AccessRule(Scope.TREE, Right.PARAM_SET),
    "rossec.watchGraph": AccessRule(Scope.MASTER, Right.GRAPH),  # and the answer is filtered
    "rossec.followSite": AccessRule(Scope.MASTER, Right.GRAPH),  # as above
    "rossec.presentGrants": AccessRule(Scope.OPEN),
    "rossec.renewGrants": AccessRule(Scope.MEMBER),  # only grants of the caller itself are renewed
    names.RENEW_IDENTITY: AccessRule(Scope.MEMBER),  # the request is signed with the key to renew
    names.WATCH_RENEWALS: AccessRule(Scope.AUTHORITY),
    names.SETTLE_RENEWALS: AccessRule(Scope.AUTHORITY),
    "rossec.updateDelegation": AccessRule(Scope.MEMBER),  # signed by the authority
    "rossec.revocations": AccessRule(Scope.OPEN),
    "rossec.revocationsSince": AccessRule(Scope.OPEN),
    "rossec.updateRevocationTree": AccessRule(Scope.MEMBER),
    "rossec.revocationEntries": AccessRule(Scope.MASTER, Right.GRAPH),  # only for own masters
    "rossec.revocationProofs": AccessRule(Scope.OPEN),  # the caller must know an entry to query it
    "rossec.depositGrants": AccessRule(Scope.AUTHORITY),
    "rossec.deliveryStates": AccessRule(Scope.AUTHORITY),
    "rossec.revocationStatus": AccessRule(Scope.AUTHORITY),
    "rossec.recentDenials": AccessRule(Scope.AUTHORITY),
    "rossec.fetchGrants": AccessRule(Scope.OPEN),  # only grants of the caller's key are returned
    "rossec.watchGrants": AccessRule(Scope.OPEN),  # as above
    "rossec.trl": AccessRule(Scope.FILTERED),  # all entries with ADMIN on the master
    "rossec.updateRevocations": AccessRule(Scope.MEMBER),  # signed by the authority
    names.DOMAINS: AccessRule(Scope.MEMBER),
    names.UPDATE_DOMAINS: AccessRule(Scope.MEMBER),  # signed by the authority
    names.FOREIGN_REVOCATIONS: AccessRule(Scope.MEMBER),
    names.FOREIGN_PROOFS: AccessRule(Scope.MEMBER),  # the caller must know an entry to query it
    names.RELAY_FORWARDED_PORTS: AccessRule(Scope.RELAY),
    names.RELAY_TARGET: AccessRule(Scope.RELAY),  # of what is exported to the domain it asks for
}


# What an administrator may call as another node: `rosnode cleanup`, after it died
CLEANUP_METHODS: Final = frozenset({"unregisterPublisher", "unregisterSubscriber", "unregisterService"})


class AccessControl:
    """Authorizes calls whose arguments are already resolved."""

    def __init__(
        self, graph: Graph, master: str, is_forwarded_port: Callable[[Endpoint], bool] = lambda _place: False
    ) -> None:
        self._graph = graph
        self._registry = graph.registry
        self._master = master  # the master's own certified name; ADMIN is a right on this name
        self._is_forwarded_port = (
            is_forwarded_port  # whether a relay of this site has one here: no node is there
        )

    def acting_caller(self, method: str, caller: Caller, caller_id: str) -> Caller:
        """The caller as the node `caller_id`: itself, or a node whose registrations it cleans up."""
        # 2. Identity: the certified name, or a name in its tail; with admin on a node, that node.
        try:
            return caller.acting_as(caller_id)
        except Refused:
            node = self._registry.node(caller_id)
            if method not in CLEANUP_METHODS or node is None or not caller.may(Right.ADMIN, caller_id):
                raise
            return replace(
                caller, name=node.name, thumbprint=node.thumbprint, wildcard=False, certified=caller.name
            )

    def check(  # noqa: C901, PLR0912 - the steps of the specification
        self, method: str, caller: Caller, arguments: tuple[object, ...], *, is_local: bool = True
    ) -> None:
        # The steps are those of docs/spec/master.md, section 1; the rule of TREE is checked by
        # `parameter_calls`, which knows what is in a tree.
        # 4. The right. Who may end a node may also look up what it provides: `rosnode cleanup` does.
        rule = RULES.get(method)
        if rule is None:
            raise Refused("no rule allows this method")
        scope, right = rule.scope, rule.right
        if scope is Scope.NAMED and right is not None:
            name = str(arguments[rule.name])
            providers = (
                self._registry.registered_nodes(Kind.SERVICE, name) if method == "lookupService" else ()
            )
            if not any(caller.may(Right.ADMIN, node.name) for node in providers):
                if right in _OFFERED:
                    if is_alias(name):
                        raise Refused(_NOT_OFFERED.format(name))
                    require_gateway(caller, name)
                if right is not Right.SUBSCRIBE or not may_subscribe(caller, name):
                    require(caller, right, name)
        elif scope is Scope.MASTER and right is not None:
            require(caller, right, self._master)
        elif scope is Scope.AUTHORITY and not caller.is_authority:
            raise Refused(f"only the authority's own node {AUTHORITY} may call this")
        elif scope is Scope.MEMBER and caller.is_foreign:
            raise Refused("only nodes of the own domain may call this")
        elif scope is Scope.RELAY and not (is_relay_name(caller.name) and _is_certified_so(caller)):
            raise Refused("only relays of the own domain may call this")
        # 5. The address, after the right: without it a caller must not learn which are registered.
        if rule.api is not None and scope is not Scope.TREE:
            require_address(self._registry, caller, str(arguments[rule.api]), is_local=is_local)
        if scope is Scope.NAMED:
            given = [str(arguments[at]) for at in (rule.api, rule.service) if at is not None]
            if any(self._is_forwarded_port(endpoint(uri)) for uri in given):  # its target would lose it here
                raise Refused("a relay of this site listens at this address")
        if rule.service is not None and caller.is_foreign:
            _require_foreign_address(self._registry, caller, str(arguments[rule.service]), is_local=is_local)

    def visible_nodes(self, caller: Caller, key: str, nodes: tuple[str, ...]) -> tuple[str, ...]:
        # Which of the nodes registered for `key` the caller may see. A foreigner sees no visitors of other
        # domains and no nodes of other sites.
        if caller.is_foreign:
            is_seen = caller.may_see(key)
            return tuple(n for n in nodes if n == caller.name or (is_seen and not is_alias(n)))
        if caller.may_see(key):
            return nodes
        if is_alias(key) and may_see_served(caller, key):  # of what is here, nothing of the origin
            return tuple(n for n in nodes if not is_alias(n))
        return (caller.name,) if caller.name in nodes else ()

    def is_node_visible(self, caller: Caller, name: str) -> bool:
        if name == caller.name:
            return True
        if caller.may(Right.GRAPH, name) and (caller.exported is None or caller.may_see(name)):
            return True
        if caller.is_foreign and is_alias(name):
            return False
        kinds = (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)
        keys = ((kind, key) for kind in kinds for key in self._graph.keys_of(name, kind))
        return any(
            caller.may_see(key) and not (kind is Kind.PUBLISHER and caller.slot(key))
            for kind, key in keys  # of what is in slots `publisher_views` tells
        )


def is_authority(peer: Identity) -> bool:
    # Whether a peer is the authority's own node: its name, certified by the root itself. Whoever holds an
    # intermediate can certify any name below it.
    return peer.name == AUTHORITY and not peer.wildcard and len(peer.keys) == 1


def require(caller: Caller, right: Right, name: str) -> None:
    """Raise `Refused`, which names the missing right, unless `caller` has `right` on `name`."""
    if caller.may(right, name):
        return
    try:
        caller.explain(right, name)
    except HintedError as error:
        hint = f" ({hint})" if (hint := caller.hint_of(error, right, name)) else ""
        needs = f"{caller.display_name} needs the right {right.label} on {shown(name)}"
        raise Refused(f"{needs}: {error}{hint}", (right, name)) from error


def require_address(registry: Registry, caller: Caller, uri: str, *, is_local: bool) -> None:
    """Raise `Refused` unless the slave API may be the caller's; to be called after its right was checked."""
    if not is_local and is_loopback_host(endpoint(uri)[0]):
        raise Refused(
            "this slave API URI is on the master's host, and the caller is not: "
            "set ROS_IP or ROS_HOSTNAME to an address that is reachable from other hosts"
        )
    if caller.is_foreign:
        _require_foreign_address(registry, caller, uri, is_local=is_local)
    _require_free(registry, caller, uri)


def _require_free(registry: Registry, caller: Caller, uri: str) -> None:
    owner = registry.owner(uri)
    node = None if owner is None or owner == caller.name else registry.node(owner)
    if node is not None:
        raise AddressTaken(node)


def _require_foreign_address(registry: Registry, caller: Caller, uri: str, *, is_local: bool) -> None:
    # Raise `Refused` for an address that a foreigner, slave API or service, cannot have. One that is
    # registered here as either, and one that a node of another network cannot have: a link-local one names
    # another machine in each network.
    _require_free(registry, caller, uri)
    for node in registry.providers_at(endpoint(uri)):
        if node.name != caller.name:
            raise AddressTaken(node)
    host = endpoint(uri)[0]
    if not is_reachable_from_here(host) and not (is_local and is_loopback_host(host)):
        raise Refused(f"a node of another domain cannot be at {printable(host)}")


def require_capacity(registry: Registry, kind: Kind, key: str, node: NodeRef) -> None:
    if not registry.has_capacity(kind, key, node):
        if registry.is_current(node):
            raise Refused(
                f"{node.name} has {REGISTRATIONS_LIMIT} registrations as {kind.value}, the limit of a node"
            )
        raise Refused(f"the identity of {node.name} has {registry.nodes_limit} nodes, the limit of one key")


# Rights on aliases by what a gateway serves: by the served name, from own grants alone. Who holds `subscribe`
# on `/gateway/LABEL/t` may subscribe `/remote/LABEL/t`, and is told the gateway and nothing of the origin:
# neither its publishers nor its nodes. A right at the origin is another one, and neither stands for the other
# (docs/spec/gateway.md). It ends with the trust in the domain that the label stands for. A gateway itself is
# the origin's receiver: to it an alias is the origin's alone, or it could forward to itself.


def is_own_gateway(caller: Caller) -> bool:
    return is_gateway(caller.name) and _is_certified_so(caller)


def _is_certified_so(caller: Caller) -> bool:
    return not caller.certified and not caller.wildcard


def may_subscribe(caller: Caller, topic: str) -> bool:
    return caller.may(Right.SUBSCRIBE, topic) or may_be_served(caller, topic)


def may_be_served(caller: Caller, alias: str) -> bool:
    served = _served(caller, alias)
    return served is not None and caller.may(Right.SUBSCRIBE, served)


def may_see_served(caller: Caller, alias: str) -> bool:
    served = _served(caller, alias)
    return served is not None and caller.may_see(served)


def require_gateway(caller: Caller, name: str) -> None:
    if is_in_gateway(name) and not is_own_gateway(caller):
        raise Refused(
            f"{name} is below {GATEWAY}, where only gateways of this domain publish and provide "
            "(choose another name)"
        )


def require_place(registry: Registry, topic: str, node: NodeRef) -> None:
    """Raise `Refused` if `node` is one gateway too many that publishes below `/gateway`."""
    if not is_in_gateway(topic):
        return
    if any(map(is_in_gateway, registry.keys_of(node.name, Kind.PUBLISHER))):
        return
    others = (other.name for other in registry.nodes() if other.name != node.name)
    if sum(map(is_gateway, others)) >= MAX_GATEWAYS:
        raise Refused(f"{MAX_GATEWAYS} gateways are registered, the limit of a master")


def _served(caller: Caller, alias: str) -> str | None:
    if not is_alias(alias) or caller.is_foreign or is_own_gateway(caller):
        return None
    try:
        found, served = split_alias(alias), served_name(alias)
    except NameRefused:
        return None
    domain = None if found is None else caller.domain_of(found[0])
    return None if domain is None or domain == OWN_DOMAIN else served
