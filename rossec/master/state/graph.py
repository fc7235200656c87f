"""The graph as queries see it: the own registrations, what is imported, what is served. Pure.

Imported nodes are aliases, so no name of a node occurs twice; a topic occurs once, with the nodes
of all masters. What is yielded one by one is as of when it is yielded.
"""

from collections.abc import Callable, Iterator, Mapping
from typing import Final, NamedTuple

from ca.bounded import Newest
from ca.errors import NameRefused
from ca.names import alias_of_served, is_alias, is_in_gateway, served_name
from grants.limits import MAX_SLOT
from grants.model import Right
from rossec.master.state.imports import Imports
from rossec.master.state.registry import ANY_TYPE, Kind, NodeRef, Registry

MAX_ENDED: Final = 16  # of one topic
MAX_TOPICS: Final = 512  # with publishers that have ended


class Published(NamedTuple):
    """A publisher of a topic, from the second `since` to the second `until`, both included."""

    node: NodeRef
    type: str
    since: int
    until: int | None = None


class PublisherLog:
    """Who published what, from when to when, for those who may know it only to a slot."""

    # They are told who published at the beginning of the slot of the master's clock that is now, so what they
    # are told changes at the beginnings of slots alone (docs/spec/master.md). That is a function of spans of
    # time, so nothing is kept for a receiver. Only the own registrations are noted; a span is in whole
    # seconds, as slots are. What ended is kept for the longest slot, and bounded. `now` is set by whoever
    # uses the log, before.
    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._current: dict[str, dict[NodeRef, Published]] = {}
        self._ended: Newest[str, list[Published]] = Newest(MAX_TOPICS)
        self.now = 0

    def __len__(self) -> int:
        return sum(map(len, (*self._current.values(), *self._ended.values())))

    def note(self, topic: str, is_cut: Callable[[NodeRef], bool] = lambda _node: False) -> None:
        # What a revocation or the end of a right has ended is in no later answer.
        nodes = self._registry.registered_nodes(Kind.PUBLISHER, topic)
        known = self._current.get(topic, {})
        for node in known.keys() - set(nodes):
            published = known.pop(node)
            if not is_cut(node):
                self._keep(topic, published._replace(until=self.now))
        type_name = self._registry.topic_type(topic)
        for node in nodes:
            known.setdefault(node, Published(node, type_name, self.now))
        if known:
            self._current[topic] = known
        else:
            self._current.pop(topic, None)

    def at(self, topic: str, slot: int) -> list[Published]:
        # Who published `topic` at the beginning of the slot of so many seconds that is now.
        self.note(topic)
        begin = self.now - self.now % slot
        ended = self._ended.get(topic, ())
        found = [each for each in ended if each.until is not None and each.until >= begin]
        found += self._current.get(topic, {}).values()
        return [each for each in found if each.since < begin]

    def ended_topics(self, name: str | None = None) -> Iterator[str]:
        for topic, ended in tuple(self._ended.items()):
            if name is None or any(each.node.name == name for each in ended):
                yield topic

    def topics(self) -> list[str]:
        return list({**self._current, **self._ended})

    def _keep(self, topic: str, published: Published) -> None:
        oldest = self.now - MAX_SLOT
        ended = (*self._ended.get(topic, ()), published)
        self._ended[topic] = [each for each in ended if (each.until or 0) >= oldest][-MAX_ENDED:]


class ServedTopics:
    """What gateways serve now, of the own registrations and of other masters of the domain."""

    # A gateway is an ordinary publisher of served names (`ca.names`). One that does not answer the master
    # serves nothing while that lasts: its registrations stay, `Registry.is_silent` says so. Those of other
    # masters serve where none does here, and then one of them: from two a subscriber would get each message
    # twice.
    def __init__(self, registry: Registry, imports: Imports) -> None:
        self._registry = registry
        self._imports = imports
        self._version = (-1, -1)
        self._gateways: Mapping[str, tuple[str, ...]] = {}

    def uris(self, alias: str) -> list[str]:
        served = _served(alias)
        if served is None or not self._is_taken(alias):
            return []
        nodes = self._registry.registered_nodes(Kind.PUBLISHER, served)
        own = [node.uri for node in nodes if not self._registry.is_silent(node)]
        return own or self._imports.publisher_uris(served)[:1]

    def gateways(self) -> Mapping[str, tuple[str, ...]]:
        version = self._registry.version, self._imports.version
        if self._version != version:
            self._version, self._gateways = version, self._find()
        return self._gateways

    def topic_type(self, alias: str) -> str:
        served = _served(alias)
        if served is None:
            return ANY_TYPE
        own = self._registry.topic_type(served)
        return self._imports.topic_type(served) if own == ANY_TYPE else own

    def _find(self) -> dict[str, tuple[str, ...]]:
        own, imported = self._registry.keys(Kind.PUBLISHER), self._imports.keys(Kind.PUBLISHER)
        keys = dict.fromkeys(key for keys in (own, imported) for key in keys if is_in_gateway(key))
        found = ((alias_of_served(key), self._names(key)) for key in keys)
        served = ((alias, names) for alias, names in found if alias is not None and names)
        return {alias: names for alias, names in served if self._is_taken(alias)}

    def _is_taken(self, alias: str) -> bool:
        return self._imports.filter.gives(Right.SUBSCRIBE, alias)

    def _names(self, served: str) -> tuple[str, ...]:
        nodes = self._registry.registered_nodes(Kind.PUBLISHER, served)
        own = tuple(node.name for node in nodes if not self._registry.is_silent(node))
        return own or self._imports.nodes_of(Kind.PUBLISHER, served)[:1]


def _served(alias: str) -> str | None:
    try:
        return served_name(alias)
    except NameRefused:
        return None


class GraphNode(NamedTuple):
    name: str
    uri: str


class Graph:
    def __init__(self, registry: Registry, imports: Imports) -> None:
        self.registry: Final = registry
        self.imports: Final = imports
        self.presence: Final = PublisherLog(registry)
        self.served: Final = ServedTopics(registry, imports)

    @property
    def version(self) -> int:
        """Grows with every change, so equal versions mean equal state."""
        return self.registry.version + self.imports.version

    def entries(self, kind: Kind) -> Iterator[tuple[str, tuple[str, ...]]]:
        own = frozenset(self.registry.keys(kind))
        imported = tuple(self.imports.keys(kind))
        for key, nodes in self.registry.entries(kind):
            yield key, (*nodes, *self.imports.nodes_of(kind, key))
        for key in imported:
            if key not in own and (nodes := self.imports.nodes_of(kind, key)):
                yield key, nodes

    def nodes(self) -> Iterator[GraphNode]:
        for node in tuple(self.registry.nodes()):
            yield GraphNode(node.name, node.uri)
        for name, uri in self.imports.nodes():
            yield GraphNode(name, uri)

    def node_uri(self, name: str) -> str | None:
        return self.registry.node_uri(name) or self.imports.node_uri(name)

    def service_uri(self, service: str) -> str | None:
        return self.registry.service_uri(service) or self.imports.service_uri(service)

    def topic_type(self, topic: str) -> str:
        """The type of a topic, `*` while it is unknown; of an alias here nobody decides."""
        own = self.registry.topic_type(topic)
        if not is_alias(topic):
            return self.imports.topic_type(topic) if own == ANY_TYPE else own
        found = (self.imports.topic_type(topic), self.served.topic_type(topic), own)
        return next((name for name in found if name != ANY_TYPE), ANY_TYPE)

    def topic_types(self) -> Iterator[tuple[str, str]]:
        """Every topic whose type is known, and those of the own registry in any case."""
        seen = dict(self.registry.topic_types())
        kinds = (Kind.PUBLISHER, Kind.SUBSCRIBER)
        imported = {key: None for kind in kinds for key in self.imports.keys(kind)}
        imported |= dict.fromkeys(self.served.gateways())
        for topic in seen:
            yield topic, self.topic_type(topic)
        for topic in imported:
            if topic not in seen and (name := self.topic_type(topic)) != ANY_TYPE:
                yield topic, name

    def keys_of(self, name: str, kind: Kind) -> tuple[str, ...]:
        return self.registry.keys_of(name, kind) or self.imports.keys_of(name, kind)
