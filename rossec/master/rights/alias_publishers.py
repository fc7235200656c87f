"""What each subscriber of an alias, or in slots, is told of publishers: its own list. Pure.

Who may be served, and for whom a gateway is registered, is told the gateway alone; who has but the
right at the origin is told the origin's publishers; anybody else nothing. So a list changes when a
gateway comes, goes or falls silent, when sites report changes, and with the subscriber's rights.
What each was told is kept, so that only they are sent an update whose own list is another one. Who
may know who publishes only to a slot is told at the beginnings of slots (`slotted_views`).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from ca.domains.aliases import is_alias
from ca.domains.served import alias_of_served, is_in_gateway
from ca.names import covers
from grants.model import Right
from rossec.master.rights.caller import Caller
from rossec.master.rights.served_rights import may_be_served
from rossec.master.state.graph import Graph
from rossec.master.state.registry import Kind, NodeRef, PublishersChanged

CallerOf = Callable[[NodeRef, int], Caller | None]
"""A registered node with its rights at a time; None: its key is revoked."""


class _Told(NamedTuple):
    """What a node was told last, by alias."""

    node: NodeRef
    uris: dict[str, tuple[str, ...]]


class AliasPublishers:
    """The lists of these subscribers; of other topics everybody has the same.

    Args:
        caller_of: of `TrustState`.
    """

    def __init__(self, graph: Graph, caller_of: CallerOf) -> None:
        self.graph: Final = graph
        self._registry: Final = graph.registry
        self._served: Final = graph.served
        self._caller_of = caller_of
        self._told: dict[str, _Told] = {}
        self._slots = set[int]()  # of those who are told in slots
        self.on_slot: Callable[[], None] = _ignore  # called when `next_slot` may be sooner

    def __len__(self) -> int:
        return sum(len(told.uris) for told in self._told.values())

    def uris(self, caller: Caller, topic: str) -> list[str]:
        """The slave API URIs that a caller, with its rights now, is told of a topic."""
        if not is_alias(topic):
            slot = caller.slot(topic)
            return self._at(topic, slot) if slot else self._registry.publisher_uris(topic)
        if may_be_served(caller, topic) and (gateways := self._served.uris(topic)):
            return gateways
        if caller.may(Right.SUBSCRIBE, topic):
            return self._registry.publisher_uris(topic)
        return []

    def tell(self, caller: Caller, topic: str, node: NodeRef) -> list[str]:
        """As `uris`, for the answer to a registration of `node`, which is remembered."""
        found = self.uris(caller, topic)
        if is_alias(topic) or caller.slot(topic):
            self._remember(node, topic, tuple(found))
        return found

    def forget(self, topic: str, name: str) -> None:
        """The node `name` has unregistered."""
        if name in self._told:
            self._told[name].uris.pop(topic, None)

    def updates(self, event: PublishersChanged, now: int) -> Sequence[PublishersChanged]:
        """The events to deliver for one of the registry, which knows no rights."""
        self._note(event.topic, now)
        if is_alias(event.topic):
            return self.changes(event.topic, now)
        served = self.changes(event.topic, now) if is_in_gateway(event.topic) else []
        found = (node for node in event.subscribers if self._is_apart(node, event.topic, now))
        apart = dict.fromkeys(found)
        if not apart:
            return (event, *served)
        others = tuple(node for node in event.subscribers if node not in apart)
        changes = (each for node in apart for each in self._change(node, event.topic, now))
        return (replace(event, subscribers=others), *changes, *served)

    def changes(self, topic: str, now: int) -> list[PublishersChanged]:
        """The events for the subscribers of an alias, or served name, whose list has changed."""
        alias = topic if is_alias(topic) else alias_of_served(topic)
        if alias is None:
            return []
        nodes = self._registry.registered_nodes(Kind.SUBSCRIBER, alias)
        return [event for node in nodes for event in self._change(node, alias, now)]

    def changes_for(self, name: str, now: int) -> list[PublishersChanged]:
        """The same for the nodes of one certified name: its rights have changed."""
        names = [each for each in self._told if covers(name, each, wildcard=True)]
        return [event for each in names for event in self._changes_of(each, now)]

    def all_changes(self, now: int) -> Iterator[list[PublishersChanged]]:
        """The same for all nodes, one by one; what is kept of others is forgotten."""
        if not self._told:
            self._slots.clear()
        for name in tuple(self._told):
            yield self._changes_of(name, now)

    def next_slot(self, now: int) -> int | None:
        """When a slot begins next in which somebody may have to be told; None: nobody."""
        return min((now - now % slot + slot for slot in self._slots), default=None)

    def _at(self, topic: str, slot: int) -> list[str]:
        if slot not in self._slots:
            self._slots.add(slot)
            self.on_slot()
        own = [each.node.uri for each in self.graph.presence.at(topic, slot)]
        return [*own, *self._registry.imported_publishers(topic)]

    def _note(self, topic: str, now: int) -> None:
        """Note who publishes a topic now, and who had to go."""

        def is_cut(node: NodeRef) -> bool:
            caller = self._caller_of(node, now)
            return caller is None or not caller.may(Right.PUBLISH, topic)

        self.graph.presence.now = now
        self.graph.presence.note(topic, is_cut)

    def _is_apart(self, node: NodeRef, topic: str, now: int) -> bool:
        """Whether a subscriber is told in slots, or was until now."""
        caller = self._caller_of(node, now)
        told = self._told.get(node.name)
        was = told is not None and told.node == node and topic in told.uris
        return was or (caller is not None and caller.slot(topic) > 0)

    def _changes_of(self, name: str, now: int) -> list[PublishersChanged]:
        told = self._told.get(name)
        if told is None:
            return []
        subscribed = set(self._registry.keys_of(name, Kind.SUBSCRIBER))
        for alias in told.uris.keys() - subscribed:
            del told.uris[alias]
        if not told.uris or self._registry.node(name) != told.node:
            del self._told[name]
            return []
        return [event for a in tuple(told.uris) for event in self._change(told.node, a, now)]

    def _change(self, node: NodeRef, alias: str, now: int) -> Iterator[PublishersChanged]:
        caller, self.graph.presence.now = self._caller_of(node, now), now
        if caller is None:  # its registrations are being removed
            return
        found, told = tuple(self.uris(caller, alias)), self._told.get(node.name)
        if told is None or told.node != node or told.uris.get(alias, ()) != found:
            self._remember(node, alias, found)
            yield PublishersChanged(alias, (node,), found)

    def _remember(self, node: NodeRef, alias: str, uris: tuple[str, ...]) -> None:
        told = self._told.get(node.name)
        if told is None or told.node != node:
            told = self._told[node.name] = _Told(node, {})
        told.uris[alias] = uris


def _ignore() -> None:
    pass
