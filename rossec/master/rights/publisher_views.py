"""What each caller is told of publishers: of aliases, in slots, with what gateways serve. Pure.

Who may be served, and for whom a gateway is registered, is told the gateway alone; who has but the
right at the origin is told the origin's publishers; anybody else nothing. So a list changes when a
gateway comes, goes or falls silent, when sites report changes, and with the subscriber's rights.
Whose only right on a topic is to subscribe it in slots (`Caller.slot`) is shown who published at
the beginning of the slot, under the address and type of then. What is imported is told as it comes,
and subscribers and services are: nothing of them is in slots.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

from ca.names import alias_of_served, covers, is_alias, is_in_gateway
from grants.model import Right
from rossec.master.rights.access_rules import may_be_served, may_see_served
from rossec.master.rights.caller import Caller
from rossec.master.state.graph import Graph, GraphNode
from rossec.master.state.registry import ANY_TYPE, Kind, NodeRef, PublishersChanged

# A registered node with its rights at a time; None: its key is revoked
CallerOf = Callable[[NodeRef, int], Caller | None]


class _Told(NamedTuple):
    node: NodeRef
    uris: dict[str, tuple[str, ...]]


class AliasPublishers:
    """The lists of these subscribers, as each was told; of other topics everybody has the same."""

    def __init__(self, graph: Graph, caller_of: CallerOf) -> None:
        self.graph: Final = graph
        self._registry: Final = graph.registry
        self._served: Final = graph.served
        self._caller_of = caller_of
        self._told: dict[str, _Told] = {}
        self._slots = set[int]()  # of those who are told in slots
        self.on_slot: Callable[[], object] = lambda: None  # called when `next_slot` may be sooner

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
        if name in self._told:
            self._told[name].uris.pop(topic, None)

    def updates(self, event: PublishersChanged, now: int) -> Sequence[PublishersChanged]:
        """The events to deliver for one of the registry, which knows no rights."""

        def is_cut(node: NodeRef) -> bool:
            caller = self._caller_of(node, now)
            return caller is None or not caller.may(Right.PUBLISH, event.topic)

        self.graph.presence.now = now
        self.graph.presence.note(event.topic, is_cut)
        if is_alias(event.topic):
            return self.changes(event.topic, now)
        served = self.changes(event.topic, now) if is_in_gateway(event.topic) else []
        apart = dict[NodeRef, None]()  # those who have another list than all others
        for node in event.subscribers:
            caller, told = self._caller_of(node, now), self._told.get(node.name)
            was = told is not None and told.node == node and event.topic in told.uris
            if was or (caller is not None and caller.slot(event.topic) > 0):
                apart[node] = None
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
        names = [each for each in self._told if covers(name, each, wildcard=True)]
        return [event for each in names for event in self._changes_of(each, now)]

    def all_changes(self, now: int) -> Iterator[list[PublishersChanged]]:
        """The same for all nodes, one by one; what is kept of others is forgotten."""
        if not self._told:
            self._slots.clear()
        for name in tuple(self._told):
            yield self._changes_of(name, now)

    def next_slot(self, now: int) -> int | None:
        return min((now - now % slot + slot for slot in self._slots), default=None)

    def _at(self, topic: str, slot: int) -> list[str]:
        if slot not in self._slots:
            self._slots.add(slot)
            self.on_slot()
        own = [each.node.uri for each in self.graph.presence.at(topic, slot)]
        return [*own, *self._registry.imported_publishers(topic)]

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


Entry = tuple[str, tuple[str, ...]]


def shown_publishers(graph: Graph, caller: Caller, found: Iterator[Entry]) -> Iterator[Entry]:
    """The topics of `found` with their publishers, and those of which all have ended since."""
    seen = set[str]()
    for topic, nodes in found:
        seen.add(topic)
        slot = caller.slot(topic)
        yield topic, _told(graph, topic, slot, nodes) if slot else nodes
    for topic in graph.presence.ended_topics():
        if topic not in seen and (slot := caller.slot(topic)):
            yield topic, _told(graph, topic, slot, ())


def topic_types(graph: Graph, caller: Caller) -> Iterator[tuple[str, str] | None]:
    """Every topic with its type, as `topic_type`; None for one whose type is not told."""
    seen = set[str]()
    for topic, name in graph.topic_types():
        seen.add(topic)
        yield _typed(graph, caller, topic) if caller.slot(topic) else (topic, name)
    for topic in graph.presence.ended_topics() if caller.has_slots else ():
        if topic not in seen and caller.slot(topic):
            yield _typed(graph, caller, topic)


def topic_type(graph: Graph, caller: Caller, topic: str) -> str:
    slot = caller.slot(topic)
    if not slot:
        return graph.topic_type(topic)
    told = graph.presence.at(topic, slot)
    return told[-1].type if told else graph.imports.topic_type(topic)


def is_published(graph: Graph, caller: Caller, topic: str) -> bool:
    """Whether publishers of a topic are told; True of every topic that is not in slots."""
    slot = caller.slot(topic)
    return not slot or bool(graph.presence.at(topic, slot) or graph.imports.nodes_of(Kind.PUBLISHER, topic))


def is_shown(graph: Graph, caller: Caller, topic: str) -> bool:
    return is_published(graph, caller, topic) or any(graph.registry.registered_nodes(Kind.SUBSCRIBER, topic))


def shown_nodes(graph: Graph, caller: Caller) -> Iterator[GraphNode | None]:
    """The nodes that are shown as publishers in slots; None for each topic without any."""
    for topic in graph.presence.topics() if caller.has_slots else ():
        slot = caller.slot(topic)
        told = graph.presence.at(topic, slot) if slot else []
        yield from (GraphNode(each.node.name, each.node.uri) for each in told)
        if not told:
            yield None


def node_uri(graph: Graph, caller: Caller, name: str) -> str | None:
    if not caller.has_slots:
        return None
    own = graph.registry.keys_of(name, Kind.PUBLISHER)
    for topic in (*own, *graph.presence.ended_topics(name)):
        slot = caller.slot(topic)
        for each in graph.presence.at(topic, slot) if slot else ():
            if each.node.name == name:
                return each.node.uri
    return None


def _typed(graph: Graph, caller: Caller, topic: str) -> tuple[str, str] | None:
    name = topic_type(graph, caller, topic)
    return None if name == ANY_TYPE else (topic, name)


def _told(graph: Graph, topic: str, slot: int, found: tuple[str, ...]) -> tuple[str, ...]:
    own = (each.node.name for each in graph.presence.at(topic, slot))
    return (*own, *(name for name in found if is_alias(name)))


def shown_entries(graph: Graph, caller: Caller, kind: Kind) -> Iterator[Entry]:
    """All names of one kind, each with its nodes; gateways only where the caller may see them."""
    found = graph.entries(kind)
    if kind is Kind.PUBLISHER and caller.has_slots:
        found = shown_publishers(graph, caller, found)
    if kind is Kind.PUBLISHER and (silent := graph.registry.silent_names):
        # Another gateway takes over what one without an answer served.
        found = (
            (key, tuple(n for n in nodes if n not in silent) if is_in_gateway(key) else nodes)
            for key, nodes in found
        )
    if kind is not Kind.PUBLISHER or not (served := graph.served.gateways()):
        return found
    return _with_gateways(caller, found, dict(served))


def _with_gateways(
    caller: Caller, found: Iterator[Entry], served: dict[str, tuple[str, ...]]
) -> Iterator[Entry]:
    # Consumes `served`; names that are not visible are yielded too, as each costs time.
    for key, nodes in found:
        gateways = served.pop(key, ())
        yield key, (*nodes, *gateways) if gateways and may_see_served(caller, key) else nodes
    for key, gateways in served.items():
        yield key, gateways if may_see_served(caller, key) else ()


def is_topic_visible(graph: Graph, caller: Caller, topic: str) -> bool:
    """Whether the caller may see a topic: it is registered for it, has a right, or is served."""
    own = (Kind.PUBLISHER, Kind.SUBSCRIBER)
    if any(graph.registry.is_registered(kind, topic, caller.name) for kind in own):
        return True
    if caller.may_see(topic):
        return is_shown(graph, caller, topic)
    is_served = is_alias(topic) and topic in graph.served.gateways()
    return is_served and may_see_served(caller, topic)
