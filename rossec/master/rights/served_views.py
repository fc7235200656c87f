"""The topics in answers about the graph, with what gateways serve. Pure.

To who may see a served name its alias is published by the gateways. Everything else is the graph's,
and a master without gateways answers from the graph alone.
"""

from collections.abc import Iterator

from ca.domains.aliases import is_alias
from ca.domains.served import is_in_gateway
from rossec.master.rights.caller import Caller
from rossec.master.rights.served_rights import may_see_served
from rossec.master.rights.slotted_views import is_shown, publishers
from rossec.master.state.graph import Graph
from rossec.master.state.registry import Kind


def entries(graph: Graph, caller: Caller, kind: Kind) -> Iterator[tuple[str, tuple[str, ...]]]:
    """All names of one kind, each with its nodes; gateways only where the caller may see them."""
    found = graph.entries(kind)
    if kind is Kind.PUBLISHER and caller.has_slots:
        found = publishers(graph, caller, found)
    if kind is Kind.PUBLISHER and (silent := graph.registry.silent_names):
        found = _answering(found, silent)
    if kind is not Kind.PUBLISHER or not (served := graph.served.gateways()):
        return found
    return _with_gateways(caller, found, dict(served))


def is_topic_visible(graph: Graph, caller: Caller, topic: str) -> bool:
    """Whether the caller may see a topic: it is registered for it, has a right, or is served."""
    own = (Kind.PUBLISHER, Kind.SUBSCRIBER)
    if any(graph.registry.is_registered(kind, topic, caller.name) for kind in own):
        return True
    if caller.may_see(topic):
        return is_shown(graph, caller, topic)
    is_served = is_alias(topic) and topic in graph.served.gateways()
    return is_served and may_see_served(caller, topic)


def _answering(
    found: Iterator[tuple[str, tuple[str, ...]]], silent: frozenset[str]
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Served names without gateways that do not answer: another one takes over what they served."""
    for key, nodes in found:
        yield key, tuple(n for n in nodes if n not in silent) if is_in_gateway(key) else nodes


def _with_gateways(
    caller: Caller,
    found: Iterator[tuple[str, tuple[str, ...]]],
    served: dict[str, tuple[str, ...]],
) -> Iterator[tuple[str, tuple[str, ...]]]:
    """Consumes `served`; names that are not visible are yielded too, as each costs time."""
    for key, nodes in found:
        gateways = served.pop(key, ())
        if gateways and may_see_served(caller, key):
            yield key, (*nodes, *gateways)
        else:
            yield key, nodes
    for key, gateways in served.items():
        yield key, gateways if may_see_served(caller, key) else ()
