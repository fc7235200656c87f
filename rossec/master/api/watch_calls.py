"""Watching the graph: the whole state in the first answer, then only the changes. Pure.

The state is what a watcher may see of the own registrations and of what is imported. What was sent
to whom is `graph_views`'s.
"""

from collections.abc import Iterator
from typing import Final

from rossec.master.api import arguments as arg
from rossec.master.api.graph_views import BATCH, MAX_VIEWS, Fact, GraphViews, is_unchanged
from rossec.master.api.methods import CallRequest, Method, Methods, Reply, Steps
from rossec.master.rights import slotted_views
from rossec.master.rights.access_rules import AccessControl
from rossec.master.rights.caller import Caller
from rossec.master.rights.served_views import entries
from rossec.master.state.graph import Graph
from rossec.master.state.registry import ANY_TYPE, Kind

__all__ = ("BATCH", "MAX_VIEWS", "WATCH", "Fact", "WatchCalls", "facts", "is_unchanged")

WATCH: Final = "rossec.watchGraph"


def facts(graph: Graph, access_control: AccessControl, caller: Caller) -> Iterator[Fact | None]:
    """What `caller` may see of the graph, as in `getSystemState` and similar queries.

    None for each name and node that it may not see.
    """
    for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE):
        for key, names in entries(graph, caller, kind):
            shown = access_control.visible_nodes(caller, key, names)
            yield from ((kind.value, key, name) for name in shown)
            if not shown:
                yield None
            elif kind is Kind.SERVICE:
                yield "provider", key, graph.service_uri(key) or ""
            elif (type_name := slotted_views.topic_type(graph, caller, key)) != ANY_TYPE:
                yield "type", key, type_name
    seen = set[str]()
    for node in graph.nodes():
        if access_control.is_node_visible(caller, node.name):
            seen.add(node.name)
            yield "node", node.name, node.uri
        else:
            yield None
    for told in slotted_views.nodes(graph, caller):
        yield None if told is None or told.name in seen else ("node", told.name, told.uri)


class WatchCalls:
    """The call by which a node watches the graph.

    Args:
        instance: identifies this run of the master.
    """

    def __init__(self, graph: Graph, access_control: AccessControl, instance: str) -> None:
        self._graph = graph
        self._access_control = access_control
        self.views: Final = GraphViews(instance)

    def methods(self) -> Methods:
        """The entry of the method table."""
        checks = (arg.text("instance"), arg.number("cursor"))
        return {WATCH: Method(checks, {}, self._watch)}

    def _watch(self, request: CallRequest) -> Steps:
        if not request.caller.is_foreign:
            self._graph.imports.demand.ask_everything(request.now)
        return self._watch_reply(request)

    def _watch_reply(self, request: CallRequest) -> Steps:
        seen, at_once = set[Fact](), request.caller.names_per_yield
        found = facts(self._graph, self._access_control, request.caller)
        for checked, fact in enumerate(found, 1):
            if fact is not None:
                seen.add(fact)
            if not checked % at_once:
                yield
        known = request.arguments[1], request.arguments[2]
        key, version = request.caller.thumbprint, self._graph.version
        version = 0 if request.caller.has_slots else version  # it grows with each registration
        return Reply(self.views.answer(key, known, frozenset(seen), version), "state of the graph")
