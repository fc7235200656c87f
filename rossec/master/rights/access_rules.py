"""Which right each master call needs, and what a caller may see. Pure, default deny.

The table is the whole policy of the master: a method that is not in it is refused whatever it does.
Rights come from grants; whether a grant is valid now is decided behind `CallerAccess`. A refusal
tells the caller which right is missing, never whether the thing exists: what a caller may not see
answers as if it were absent.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Final, Protocol

from ca import names
from ca.errors import HintedError
from grants.model import Right
from rossec.master.state.addresses import endpoint, is_here
from rossec.master.state.registry import KEYS_LIMIT, Kind, NodeRef, Registry

ASK: Final = "ask the authority's operator for a grant"
LOOKS_AT_ONCE: Final = 64
SEES_TOPICS: Final = Right.PUBLISH | Right.SUBSCRIBE | Right.CALL | Right.PROVIDE | Right.GRAPH


class Refused(Exception):
    """The status text to answer with, after `rossec: `.

    `wanted` is the right that is missing, and the name it is missing on, if that was the reason.
    """

    def __init__(self, text: str, wanted: tuple[Right, str] | None = None) -> None:
        super().__init__(text)
        self.wanted = wanted


class AddressTaken(Refused):
    """The slave API is registered by `owner`, which may be gone: whoever answers there is right."""

    def __init__(self, owner: NodeRef) -> None:
        super().__init__("this slave API URI is registered by another node")
        self.owner = owner


class CallerAccess(Protocol):
    """What one identity may do at one moment, from the grants it presented."""

    def require(self, right: Right, name: str) -> None:
        """Raise a `HintedError` unless some valid grant covers `right` on `name`."""

    def covers(self, right: Right, name: str) -> bool:
        """Whether `require` would return."""

    def covers_any(self, rights: Right, name: str) -> bool:
        """Whether `require` would return for one of `rights`."""

    def covers_below(self, right: Right, space: str) -> bool:
        """Whether `right`, one of parameters, is given on every name below `space` (`/`: all)."""

    def touches(self, right: Right, space: str) -> bool:
        """Whether `right`, one of parameters, is given on `space` or on any name below it."""

    def patterns(self, right: Right) -> int:
        """How many patterns must be asked one by one whether they give `right`."""


class Peer(Protocol):
    """A certified name and its key: what is used of `ca.certificates.Identity`, or a `NodeRef`."""

    @property
    def name(self) -> str:
        """The certified name."""

    @property
    def thumbprint(self) -> bytes:
        """The certified key's thumbprint."""


class Certified(Peer, Protocol):
    """A peer as its certificate shows it: `ca.certificates.Identity` is one."""

    @property
    def wildcard(self) -> bool:
        """Whether the name has a wildcard tail."""

    @property
    def keys(self) -> tuple[bytes, ...]:
        """Thumbprints of every key whose revocation ends this identity, its own first."""

    def covers(self, name: str) -> bool:
        """Whether the peer may go by `name`."""


@dataclass(frozen=True)
class Caller:
    """Who calls, and what it may do.

    Attributes:
        name: the certified name; within a call the name of the node, see `acting_as`.
        thumbprint: of the certified key, to which grants are bound.
        wildcard: the certified name has a wildcard tail.
        certified: the certified name where `name` is another one.
    """

    name: str
    thumbprint: bytes
    access: CallerAccess
    wildcard: bool = False
    certified: str = ""

    @property
    def title(self) -> str:
        """Who it is, for people."""
        return f"{self.name} (certified as {self.certified})" if self.certified else self.name

    @property
    def identity(self) -> str:
        """The certified name."""
        return self.certified or self.name

    def acting_as(self, name: str) -> "Caller":
        """The caller as the node `name`, which has entries of its own in the registry.

        Raises:
            Refused: its identity does not cover `name`.
        """
        if not names.covers(self.name, name, wildcard=self.wildcard):
            raise Refused(f"this connection belongs to {self.name}, it cannot act as another")
        if name == self.name:
            return self
        return replace(self, name=name, wildcard=False, certified=self.name)

    def may(self, right: Right, name: str) -> bool:
        """Whether a grant covers `right` on `name`."""
        return self.access.covers(right, name)

    def may_all_below(self, right: Right, space: str) -> bool:
        """Whether grants cover `right`, one of parameters, on every name below `space`."""
        return self.access.covers_below(right, space)

    def may_some_below(self, right: Right, space: str) -> bool:
        """Whether a grant covers `right`, one of parameters, at `space` or anywhere below."""
        return self.access.touches(right, space)

    def patterns(self, right: Right) -> int:
        """How many patterns must be asked one by one about each name."""
        return self.access.patterns(right)

    @property
    def looks_at_once(self) -> int:
        """How many names a query looks at between two of its yields: fewer where one costs more."""
        return max(1, LOOKS_AT_ONCE // (1 + sum(map(self.access.patterns, Right)) // 8))

    def may_see(self, name: str) -> bool:
        """Whether a topic, service or node name may appear in an answer to this caller."""
        return self.access.covers_any(SEES_TOPICS, name)


class Scope(Enum):
    """What a call reaches beyond the right in its rule."""

    NAMED = "one name, an argument"
    TREE = "a parameter and all its descendants"
    OWN = "only what the caller itself registered"
    FILTERED = "the whole graph, of which the caller is shown its part"
    MASTER = "the master itself"
    OPEN = "nothing that needs a right"


@dataclass(frozen=True)
class AccessRule:
    """What a method needs.

    Attributes:
        scope: what the call reaches.
        right: the right needed on the argument at `name` (or, for MASTER, on the master's name).
        name: index of that argument, counted from the caller_id.
        api: index of the caller's slave API URI, which must not be another node's.
    """

    scope: Scope
    right: Right | None = None
    name: int = 1
    api: int | None = None


RULES: Final[Mapping[str, AccessRule]] = {
    "registerPublisher": AccessRule(Scope.NAMED, Right.PUBLISH, api=3),
    "registerSubscriber": AccessRule(Scope.NAMED, Right.SUBSCRIBE, api=3),
    "registerService": AccessRule(Scope.NAMED, Right.PROVIDE, api=3),
    "unregisterPublisher": AccessRule(Scope.OWN),
    "unregisterSubscriber": AccessRule(Scope.OWN),
    "unregisterService": AccessRule(Scope.OWN),
    "lookupService": AccessRule(Scope.NAMED, Right.CALL),
    "lookupNode": AccessRule(Scope.FILTERED),
    "getSystemState": AccessRule(Scope.FILTERED),
    "getTopicTypes": AccessRule(Scope.FILTERED),
    "getPublishedTopics": AccessRule(Scope.FILTERED),
    "getUri": AccessRule(Scope.OPEN),
    "getPid": AccessRule(Scope.OPEN),  # roscpp asks for it to learn whether the master lives
    "shutdown": AccessRule(Scope.MASTER, Right.ADMIN),
    "getParam": AccessRule(Scope.TREE, Right.PARAM_GET),
    "hasParam": AccessRule(Scope.TREE, Right.PARAM_GET),
    "subscribeParam": AccessRule(Scope.TREE, Right.PARAM_GET, name=2, api=1),
    "unsubscribeParam": AccessRule(Scope.OWN),
    "searchParam": AccessRule(Scope.FILTERED),
    "getParamNames": AccessRule(Scope.FILTERED),
    "setParam": AccessRule(Scope.TREE, Right.PARAM_SET),
    "deleteParam": AccessRule(Scope.TREE, Right.PARAM_SET),
    "rossec.watchGraph": AccessRule(Scope.MASTER, Right.GRAPH),  # of which it is shown its part
    "rossec.presentGrants": AccessRule(Scope.OPEN),
    "rossec.renewGrants": AccessRule(Scope.OPEN),  # what is renewed is the caller's own, or refused
    "rossec.renewIdentity": AccessRule(
        Scope.OPEN
    ),  # the request is signed by the key that is renewed
    "rossec.updateDelegation": AccessRule(
        Scope.OPEN
    ),  # as a list, it carries the authority's signature
    "rossec.revocations": AccessRule(Scope.OPEN),
    "rossec.revocationsSince": AccessRule(Scope.OPEN),
    "rossec.updateRevocationTree": AccessRule(Scope.OPEN),
    "rossec.revocationProofs": AccessRule(Scope.OPEN),  # whoever can ask about an entry knows it
    "rossec.trl": AccessRule(
        Scope.FILTERED
    ),  # what concerns the caller; all with ADMIN on the master
    "rossec.updateRevocations": AccessRule(
        Scope.OPEN
    ),  # the list carries the authority's signature
}


CLEANUP: Final = frozenset({"unregisterPublisher", "unregisterSubscriber", "unregisterService"})
"""What an administrator may do in the name of a node: `rosnode cleanup`, after it died."""


class AccessControl:
    """Decides on calls whose arguments are already resolved.

    Args:
        registry: to know which slave API belongs to whom.
        master: the master's own certified name; ADMIN is a right on this name.
    """

    def __init__(self, registry: Registry, master: str) -> None:
        self._registry = registry
        self._master = master

    def acting(self, method: str, caller: Caller, caller_id: str) -> Caller:
        """The caller as the node `caller_id`: itself, or a node it cleans up after.

        Raises:
            Refused: its identity does not cover that name, and it may not administer that node.
        """
        try:
            return caller.acting_as(caller_id)
        except Refused:
            node = self._registry.node(caller_id)
            if method not in CLEANUP or node is None or not caller.may(Right.ADMIN, caller_id):
                raise
            return replace(
                caller,
                name=node.name,
                thumbprint=node.thumbprint,
                wildcard=False,
                certified=caller.name,
            )

    def check(
        self, method: str, caller: Caller, arguments: tuple[object, ...], *, near: bool = True
    ) -> None:
        """The rule of `method`; of TREE the parameters, which know the reach, judge the rest.

        `near`: the caller is on the master's host.

        Raises:
            Refused: no rule, a right is missing, or the slave API is another node's.
        """
        rule = RULES.get(method)
        if rule is None:
            raise Refused("no rule allows this method")
        if rule.scope is Scope.NAMED and rule.right is not None:
            require(caller, rule.right, str(arguments[rule.name]))
        if rule.scope is Scope.MASTER and rule.right is not None:
            require(caller, rule.right, self._master)
        if rule.api is not None and rule.scope is not Scope.TREE:
            require_address(self._registry, caller, str(arguments[rule.api]), near=near)

    def nodes_shown(self, caller: Caller, key: str, nodes: tuple[str, ...]) -> tuple[str, ...]:
        """Which of the nodes registered for `key` the caller is shown."""
        if caller.may_see(key):
            return nodes
        return (caller.name,) if caller.name in nodes else ()

    def node_shown(self, caller: Caller, name: str) -> bool:
        """A node is shown to itself, with a right to see it, and to those who share a topic."""
        if name == caller.name or caller.may(Right.GRAPH, name):
            return True
        kinds = (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE)
        keys = (key for kind in kinds for key in self._registry.keys_of(name, kind))
        return any(caller.may_see(key) for key in keys)


def require(caller: Caller, right: Right, name: str) -> None:
    """Raise `Refused`, with what is missing, unless `caller` has `right` on `name`."""
    try:
        caller.access.require(right, name)
    except HintedError as error:
        hint = f" ({error.hint})" if error.hint else ""
        wanted = f"{caller.title} needs the right {label(right)} on {name}"
        raise Refused(f"{wanted}: {error}{hint}", (right, name)) from error


def require_address(registry: Registry, caller: Caller, uri: str, *, near: bool) -> None:
    """Raise `Refused` unless the slave API may be the caller's.

    After the right was judged: who has none does not hear which addresses are registered.
    """
    if not near and is_here(endpoint(uri)[0]):
        raise Refused(
            "this slave API URI is on the master's host, and the caller is not: "
            "set ROS_IP or ROS_HOSTNAME to an address at which others reach it"
        )
    owner = registry.owner(uri)
    node = None if owner is None or owner == caller.name else registry.node(owner)
    if node is not None:
        raise AddressTaken(node)


def require_room(registry: Registry, kind: Kind, key: str, node: NodeRef) -> None:
    """Raise `Refused` when a node has as many registrations, or a key as many nodes, as may be."""
    if not registry.has_room(kind, key, node):
        if registry.is_current(node):
            raise Refused(
                f"{node.name} has {KEYS_LIMIT} registrations as {kind.value}, the most of a node"
            )
        raise Refused(
            f"the identity of {node.name} has {registry.nodes_limit} nodes, the most of one key"
        )


def label(right: Right) -> str:
    """The right as grants write it."""
    return (right.name or str(int(right))).lower().replace("_", "-")
