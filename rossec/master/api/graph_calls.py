"""The calls about the graph: registering, looking up, listing. Pure; texts are stock's.

State queries are filtered by access control: a caller sees its own entries and the names that its
grants cover.
"""

from collections.abc import Generator, Iterable
from typing import Final

from rossec.master.api import arguments as arg
from rossec.master.api.methods import CallRequest, Method, Methods, Reply, Steps
from rossec.master.rights import slotted_views
from rossec.master.rights.access_rules import AccessControl, require_capacity
from rossec.master.rights.alias_publishers import AliasPublishers
from rossec.master.rights.caller import Caller
from rossec.master.rights.served_rights import require_place
from rossec.master.rights.served_views import entries, is_topic_visible
from rossec.master.state.graph import Graph
from rossec.master.state.registry import Kind
from rossec.ros.compactwrite import encode_ahead
from rossec.ros.xmlwrite import EncodedList

_MAX_CACHED_STATES: Final = 16
_MAX_CACHED_ENTRIES: Final = 8192


class GraphCalls:
    """Handlers over one graph; only the own registrations can be changed.

    Args:
        aliases: what each subscriber of an alias is told.
    """

    def __init__(
        self, graph: Graph, access_control: AccessControl, aliases: AliasPublishers
    ) -> None:
        self._aliases = aliases
        self._graph = graph
        self._registry = graph.registry
        self._demand = graph.imports.demand
        self._access_control = access_control
        self._entries: dict[tuple[str, tuple[str, ...]], EncodedList] = {}
        self._states: dict[int, tuple[Caller, EncodedList]] = {}  # by identity of the caller
        self._version = -1

    def methods(self) -> Methods:
        """The entries of the method table."""
        topic, type_name = arg.topic("topic"), arg.type_name("topic_type")
        service, api = arg.topic("service"), arg.uri("caller_api", "http")
        service_api = arg.uri("service_api", "rosrpc")
        return {
            "registerPublisher": Method((topic, type_name, api), [], self._register_publisher),
            "registerSubscriber": Method((topic, type_name, api), [], self._register_subscriber),
            "registerService": Method((service, service_api, api), 0, self._register_service),
            "unregisterPublisher": Method((topic, api), 0, self._unregister_publisher),
            "unregisterSubscriber": Method((topic, api), 0, self._unregister_subscriber),
            "unregisterService": Method((service, service_api), 0, self._unregister_service),
            "lookupNode": Method((arg.node("node"),), "", self._lookup_node),
            "lookupService": Method((service,), "", self._lookup_service),
            "getSystemState": Method((), [[], [], []], self._system_state),
            "getTopicTypes": Method((), [], self._topic_types),
            "getPublishedTopics": Method((arg.subgraph("subgraph"),), 0, self._published_topics),
        }

    def _register_publisher(self, request: CallRequest) -> Reply:
        name, topic, type_name = (request.text(i) for i in range(3))
        require_capacity(self._registry, Kind.PUBLISHER, topic, request.node(3))
        require_place(self._registry, topic, request.node(3))
        events = self._registry.register_publisher(topic, type_name, request.node(3))
        status = f"Registered [{name}] as publisher of [{topic}]"
        return Reply(self._registry.uris(Kind.SUBSCRIBER, topic), status, events=tuple(events))

    def _register_subscriber(self, request: CallRequest) -> Reply:
        topic, type_name = request.text(1), request.text(2)
        require_capacity(self._registry, Kind.SUBSCRIBER, topic, request.node(3))
        events = self._registry.register_subscriber(topic, type_name, request.node(3))
        self._demand.ask(topic, request.now)
        publishers = self._aliases.tell(request.caller, topic, request.node(3))
        return Reply(publishers, f"Subscribed to [{topic}]", events=tuple(events))

    def _register_service(self, request: CallRequest) -> Reply:
        name, service, service_uri = (request.text(i) for i in range(3))
        require_capacity(self._registry, Kind.SERVICE, service, request.node(3))
        events = self._registry.register_service(service, service_uri, request.node(3))
        return Reply(1, f"Registered [{name}] as provider of [{service}]", events=tuple(events))

    def _unregister_publisher(self, request: CallRequest) -> Reply:
        return self._unregister(Kind.PUBLISHER, request)

    def _unregister_subscriber(self, request: CallRequest) -> Reply:
        reply = self._unregister(Kind.SUBSCRIBER, request)
        if reply.value:
            self._aliases.forget(request.text(1), request.caller.name)
        return reply

    def _unregister(self, kind: Kind, request: CallRequest) -> Reply:
        done, events = self._registry.unregister(kind, request.text(1), request.node(2))
        return Reply(done.removed, done.status, events=tuple(events))

    def _unregister_service(self, request: CallRequest) -> Reply:
        caller, service, service_uri = request.caller, request.text(1), request.text(2)
        done = self._registry.unregister_service(
            service, caller.name, service_uri, caller.thumbprint
        )
        return Reply(done.removed, done.status)

    def _lookup_node(self, request: CallRequest) -> Reply:
        name = request.text(1)
        self._ask(name, request)
        uri = self._graph.node_uri(name)
        if uri is None or not self._access_control.is_node_visible(request.caller, name):
            uri = slotted_views.node_uri(self._graph, request.caller, name)
        if uri is None:
            return Reply("", f"unknown node [{name}]", -1)
        return Reply(uri, "node api")

    def _lookup_service(self, request: CallRequest) -> Reply:
        self._ask(request.text(1), request)
        uri = self._graph.service_uri(request.text(1))
        if uri is None:
            return Reply("", "no provider", -1)
        return Reply(uri, f"rosrpc URI: [{uri}]")

    def _ask(self, name: str, request: CallRequest) -> None:
        """Have other masters asked for a name that is not one of this master.

        Not for a foreigner, whoever it names: what is imported is shown to no other domain.
        """
        registered = self._registry.node_uri(name) or self._registry.service_uri(name)
        if registered is None and not request.caller.is_foreign:
            self._demand.ask(name, request.now)

    def _ask_everything(self, request: CallRequest) -> None:
        if not request.caller.is_foreign:
            self._demand.ask_everything(request.now)

    def _system_state(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        return self._system_state_reply(request.caller)

    def _system_state_reply(self, caller: Caller) -> Steps:
        return Reply((yield from self._state(caller)), "current system state")

    def _state(self, caller: Caller) -> Generator[None, None, EncodedList]:
        """What the caller may see; cached while neither the graph nor the caller changes."""
        version = self._graph.version
        if self._version != version:
            self._version = version
            self._states.clear()
        cached = self._states.get(id(caller))
        if cached is not None and cached[0] is caller:
            return cached[1]
        state = EncodedList(
            [
                (yield from self._visible_entries(Kind.PUBLISHER, caller)),
                (yield from self._visible_entries(Kind.SUBSCRIBER, caller)),
                (yield from self._visible_entries(Kind.SERVICE, caller)),
            ]
        )
        if self._graph.version == self._version == version and not caller.has_slots:
            if len(self._states) >= _MAX_CACHED_STATES:
                self._states.clear()
            self._states[id(caller)] = caller, state
        return state

    def _visible_entries(self, kind: Kind, caller: Caller) -> Generator[None, None, list[object]]:
        found, at_once = list[object](), caller.names_per_yield
        for count, (key, nodes) in enumerate(entries(self._graph, caller, kind), 1):
            if names := self._access_control.visible_nodes(caller, key, nodes):
                found.append(self._entry(key, names))
            if not count % at_once:
                yield
        return found

    def _entry(self, key: str, names: tuple[str, ...]) -> EncodedList:
        """One name with its nodes, encoded once for all callers that may see it."""
        entry = self._entries.get((key, names))
        if entry is None:
            if len(self._entries) >= _MAX_CACHED_ENTRIES:
                self._entries.clear()
            entry = self._entries[key, names] = encode_ahead(EncodedList([key, list(names)]))
        return entry

    def _topic_types(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        types = slotted_views.topic_types(self._graph, request.caller)
        return self._types_reply(request.caller, types, "current system state")

    def _published_topics(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        namespace = request.text(1)
        if namespace and not namespace.endswith("/"):
            namespace += "/"
        graph, caller = self._graph, request.caller
        published = entries(graph, caller, Kind.PUBLISHER)
        within = (
            (key, slotted_views.topic_type(graph, caller, key))
            if key.startswith(namespace) and slotted_views.is_published(graph, caller, key)
            else None
            for key, _ in published
        )
        return self._types_reply(caller, within, "current topics")

    def _types_reply(
        self, caller: Caller, topics: Iterable[tuple[str, str] | None], status: str
    ) -> Steps:
        return Reply((yield from self._visible_types(caller, topics)), status)

    def _visible_types(
        self, caller: Caller, topics: Iterable[tuple[str, str] | None]
    ) -> Generator[None, None, list[list[str]]]:
        """Those of `topics`, with their types, that the caller may see."""
        shown, at_once = list[list[str]](), caller.names_per_yield
        for count, topic in enumerate(topics, 1):
            if topic is not None and is_topic_visible(self._graph, caller, topic[0]):
                shown.append([*topic])
            if not count % at_once:
                yield
        return shown
