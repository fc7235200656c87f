"""What a caller is shown of publishers whose topics it may know only to a slot. Pure.

Its only right on such a topic is to subscribe it in slots (`Caller.slot`): it is shown who
published at the beginning of the slot, under the address and type of then. What is imported is told
as it comes, and subscribers and services are: nothing of them is in slots.
"""

from collections.abc import Iterator

from ca.domains.aliases import is_alias
from rossec.master.rights.caller import Caller
from rossec.master.state.graph import Graph, GraphNode
from rossec.master.state.registry import ANY_TYPE, Kind

Entry = tuple[str, tuple[str, ...]]


def publishers(graph: Graph, caller: Caller, found: Iterator[Entry]) -> Iterator[Entry]:
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
    """The type of a topic; of one in slots that of the publishers that are told."""
    slot = caller.slot(topic)
    if not slot:
        return graph.topic_type(topic)
    told = graph.presence.at(topic, slot)
    return told[-1].type if told else graph.imports.topic_type(topic)


def is_published(graph: Graph, caller: Caller, topic: str) -> bool:
    """Whether publishers of a topic are told; True of every topic that is not in slots."""
    slot = caller.slot(topic)
    return not slot or bool(
        graph.presence.at(topic, slot) or graph.imports.nodes_of(Kind.PUBLISHER, topic)
    )


def is_shown(graph: Graph, caller: Caller, topic: str) -> bool:
    """Whether a topic that the caller may see is anything to it yet."""
    return is_published(graph, caller, topic) or any(
        graph.registry.registered_nodes(Kind.SUBSCRIBER, topic)
    )


def nodes(graph: Graph, caller: Caller) -> Iterator[GraphNode | None]:
    """The nodes that are shown as publishers in slots; None for each topic without any."""
    for topic in graph.presence.topics() if caller.has_slots else ():
        slot = caller.slot(topic)
        told = graph.presence.at(topic, slot) if slot else []
        yield from (GraphNode(each.node.name, each.node.uri) for each in told)
        if not told:
            yield None


def node_uri(graph: Graph, caller: Caller, name: str) -> str | None:
    """The slave API of a node that is shown as a publisher in slots."""
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
