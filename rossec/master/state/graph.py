"""The graph as queries see it: the own registrations, what is imported, what is served. Pure.

Imported nodes are aliases, so no name of a node occurs twice; a topic occurs once, with the nodes
of all masters. What is yielded one by one is as of when it is yielded.
"""

from collections.abc import Iterator
from typing import Final, NamedTuple

from ca.domains.aliases import is_alias
from rossec.master.state.imports import Imports
from rossec.master.state.publisher_log import PublisherLog
from rossec.master.state.registry import ANY_TYPE, Kind, Registry
from rossec.master.state.served_topics import ServedTopics


class GraphNode(NamedTuple):
    """A node, here or imported."""

    name: str
    uri: str


class Graph:
    """Queries over both."""

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
        """All names of one kind, each with its nodes."""
        own = frozenset(self.registry.keys(kind))
        imported = tuple(self.imports.keys(kind))
        for key, nodes in self.registry.entries(kind):
            yield key, (*nodes, *self.imports.nodes_of(kind, key))
        for key in imported:
            if key not in own and (nodes := self.imports.nodes_of(kind, key)):
                yield key, nodes

    def nodes(self) -> Iterator[GraphNode]:
        """All nodes."""
        for node in tuple(self.registry.nodes()):
            yield GraphNode(node.name, node.uri)
        for name, uri in self.imports.nodes():
            yield GraphNode(name, uri)

    def node_uri(self, name: str) -> str | None:
        """The slave API URI of a node."""
        return self.registry.node_uri(name) or self.imports.node_uri(name)

    def service_uri(self, service: str) -> str | None:
        """The rosrpc URI of a service."""
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
        """The names a node is registered for."""
        return self.registry.keys_of(name, kind) or self.imports.keys_of(name, kind)
