"""The calls about the graph: registering, looking up, listing, watching. Pure; texts are stock's.

State queries are filtered by access control: a caller sees its own entries and the names that its
grants cover. A watcher is sent the whole state in the first answer, then only the changes since
what it was sent; a state is a set of facts, so all changes between two calls are sent as one.
Nothing is queued: a slow caller is updated less often, one without a stored view is sent everything.
"""

from collections.abc import Iterable, Iterator
from itertools import count
from typing import Final, NamedTuple, TypeAlias

from ca.bounded import Newest
from rossec.master.api.methods import CallRequest, MasterTables, Reply, Steps, collected
from rossec.master.rights import publisher_views
from rossec.master.rights.access_rules import AccessControl, require_capacity, require_place
from rossec.master.rights.caller import Caller
from rossec.master.rights.publisher_views import is_topic_visible, shown_entries
from rossec.master.state.graph import Graph
from rossec.master.state.registry import ANY_TYPE, Kind
from rossec.ros.compact_values import encode_ahead
from rossec.ros.xmlrpc import EncodedList

_MAX_CACHED_STATES: Final = 16
_MAX_CACHED_ENTRIES: Final = 8192


class GraphCalls:
    """Handlers over one graph; only the own registrations can be changed. `instance`: of this run."""

    def __init__(self, tables: MasterTables, access_control: AccessControl, instance: str) -> None:
        self._aliases = tables.aliases
        self._graph = tables.graph
        self._registry = tables.registry
        self._demand = tables.imports.demand
        self._access_control = access_control
        self._entries: dict[tuple[str, tuple[str, ...]], EncodedList] = {}
        self._states: dict[int, tuple[Caller, EncodedList]] = {}  # by identity of the caller
        self._version = -1
        self.views: Final = GraphViews(instance)

    def register_publisher(self, request: CallRequest) -> Reply:
        name, topic, type_name = (request.text(i) for i in range(3))
        require_capacity(self._registry, Kind.PUBLISHER, topic, request.node(3))
        require_place(self._registry, topic, request.node(3))
        events = self._registry.register_publisher(topic, type_name, request.node(3))
        status = f"Registered [{name}] as publisher of [{topic}]"
        return Reply(self._registry.uris(Kind.SUBSCRIBER, topic), status, events=tuple(events))

    def register_subscriber(self, request: CallRequest) -> Reply:
        topic, type_name = request.text(1), request.text(2)
        require_capacity(self._registry, Kind.SUBSCRIBER, topic, request.node(3))
        events = self._registry.register_subscriber(topic, type_name, request.node(3))
        self._demand.ask(topic, request.now)
        publishers = self._aliases.tell(request.caller, topic, request.node(3))
        return Reply(publishers, f"Subscribed to [{topic}]", events=tuple(events))

    def register_service(self, request: CallRequest) -> Reply:
        name, service, service_uri = (request.text(i) for i in range(3))
        require_capacity(self._registry, Kind.SERVICE, service, request.node(3))
        events = self._registry.register_service(service, service_uri, request.node(3))
        return Reply(1, f"Registered [{name}] as provider of [{service}]", events=tuple(events))

    def unregister_subscriber(self, request: CallRequest) -> Reply:
        reply = self.unregister(Kind.SUBSCRIBER, request)
        if reply.value:
            self._aliases.forget(request.text(1), request.caller.name)
        return reply

    def unregister(self, kind: Kind, request: CallRequest) -> Reply:
        done, events = self._registry.unregister(kind, request.text(1), request.node(2))
        return Reply(done.removed, done.status, events=tuple(events))

    def unregister_service(self, request: CallRequest) -> Reply:
        caller, service, service_uri = request.caller, request.text(1), request.text(2)
        done = self._registry.unregister_service(service, caller.name, service_uri, caller.thumbprint)
        return Reply(done.removed, done.status)

    def lookup_node(self, request: CallRequest) -> Reply:
        name = request.text(1)
        self._ask(name, request)
        uri = self._graph.node_uri(name)
        if uri is None or not self._access_control.is_node_visible(request.caller, name):
            uri = publisher_views.node_uri(self._graph, request.caller, name)
        if uri is None:
            return Reply("", f"unknown node [{name}]", -1)
        return Reply(uri, "node api")

    def lookup_service(self, request: CallRequest) -> Reply:
        self._ask(request.text(1), request)
        uri = self._graph.service_uri(request.text(1))
        if uri is None:
            return Reply("", "no provider", -1)
        return Reply(uri, f"rosrpc URI: [{uri}]")

    def _ask(self, name: str, request: CallRequest) -> None:
        # Have other masters asked for a name that is not one of this master.
        # Not for a foreigner, whoever it names: what is imported is shown to no other domain.
        registered = self._registry.node_uri(name) or self._registry.service_uri(name)
        if registered is None and not request.caller.is_foreign:
            self._demand.ask(name, request.now)

    def _ask_everything(self, request: CallRequest) -> None:
        if not request.caller.is_foreign:
            self._demand.ask_everything(request.now)

    def system_state(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        return self._state(request.caller)

    def _state(self, caller: Caller) -> Steps:
        version = self._graph.version
        if self._version != version:
            self._version = version
            self._states.clear()
        held, state = self._states.get(id(caller), (None, None))
        if state is None or held is not caller:
            state = EncodedList([])
            for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE):
                entries = (
                    self._entry(key, names)
                    if (names := self._access_control.visible_nodes(caller, key, nodes))
                    else None
                    for key, nodes in shown_entries(self._graph, caller, kind)
                )
                state.append(list[object]((yield from collected(entries, caller.names_per_yield))))
            # It took turns: what has changed meanwhile, or changes with the clock, is not for the next one.
            if self._graph.version == self._version == version and not caller.has_slots:
                if len(self._states) >= _MAX_CACHED_STATES:
                    self._states.clear()
                self._states[id(caller)] = caller, state
        return Reply(state, "current system state")

    def _entry(self, key: str, names: tuple[str, ...]) -> EncodedList:
        entry = self._entries.get((key, names))
        if entry is None:
            if len(self._entries) >= _MAX_CACHED_ENTRIES:
                self._entries.clear()
            entry = self._entries[key, names] = encode_ahead(EncodedList([key, list(names)]))
        return entry

    def topic_types(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        types = publisher_views.topic_types(self._graph, request.caller)
        return self._types_reply(request.caller, types, "current system state")

    def published_topics(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        namespace = request.text(1)
        if namespace and not namespace.endswith("/"):
            namespace += "/"
        graph, caller = self._graph, request.caller
        published = shown_entries(graph, caller, Kind.PUBLISHER)
        within = (
            (key, publisher_views.topic_type(graph, caller, key))
            if key.startswith(namespace) and publisher_views.is_published(graph, caller, key)
            else None
            for key, _ in published
        )
        return self._types_reply(caller, within, "current topics")

    def _types_reply(self, caller: Caller, topics: Iterable[tuple[str, str] | None], status: str) -> Steps:
        shown = (
            [*topic] if topic is not None and is_topic_visible(self._graph, caller, topic[0]) else None
            for topic in topics
        )
        return Reply((yield from collected(shown, caller.names_per_yield)), status)

    def watch(self, request: CallRequest) -> Steps:
        self._ask_everything(request)
        return self._watched(request)

    def _watched(self, request: CallRequest) -> Steps:
        found = facts(self._graph, self._access_control, request.caller)
        seen = yield from collected(found, request.caller.names_per_yield)
        # The version grows with each registration: it would tell the moment of those in slots.
        version = 0 if request.caller.has_slots else self._graph.version
        known, key = (request.arguments[1], request.arguments[2]), request.caller.thumbprint
        return Reply(self.views.answer(key, known, frozenset(seen), version), "state of the graph")


BATCH: Final = 1024  # facts in one answer
MAX_VIEWS: Final = 4  # stored for one identity
_START: Final = 0  # the cursor of a caller without state

Fact: TypeAlias = tuple[str, str, str]
# Kind, name and value: ("publisher", "/scan", "/laser"), ("type", "/scan", "pkg/Type"),
# ("provider", "/reset", "rosrpc://..."), ("node", "/laser", "http://...").

View: TypeAlias = frozenset[Fact]


class _Sent(NamedTuple):
    facts: View
    beside: tuple[bytes, ...]


class GraphViews:
    """The views of all callers of one method; `instance` identifies this run: cursors start again."""

    def __init__(self, instance: str) -> None:
        self._instance = instance
        self._cursors = count(_START + 1)
        self._views: dict[bytes, Newest[int, _Sent]] = {}

    def __len__(self) -> int:
        return sum(map(len, self._views.values()))

    def keep_only(self, thumbprints: frozenset[bytes]) -> None:
        for key in self._views.keys() - thumbprints:
            del self._views[key]

    def answer(
        self,
        caller: bytes,
        seen: tuple[object, object],
        now: View,
        version: int,
        beside: tuple[bytes, ...] = (),
    ) -> dict[str, object]:
        # The changes since the caller's last view; the cursor stays if there are none.
        instance, cursor = seen
        views = self._views.setdefault(caller, Newest(MAX_VIEWS))
        cursor = cursor if isinstance(cursor, int) and instance == self._instance else _START
        known = views.get(cursor)
        old = frozenset() if known is None else known.facts
        added, removed = sorted(now - old), sorted(old - now)
        sent_added, sent_removed = added[:BATCH], removed[:BATCH]
        if known is None or added or removed or beside != known.beside:
            views.pop(cursor, None)
            cursor = next(self._cursors)
            view = (old | frozenset(sent_added)) - frozenset(sent_removed)
            views[cursor] = _Sent(view, beside)
        return {
            "instance": self._instance,
            "version": version % (1 << 31),  # XML-RPC's integers end there
            "cursor": cursor,
            "whole": known is None,
            "more": len(added) > BATCH or len(removed) > BATCH,
            "added": [list(fact) for fact in sent_added],
            "removed": [list(fact) for fact in sent_removed],
        }


def is_unchanged(answer: object, cursor: object) -> bool:
    match answer:
        case [1, _, {"whole": False, "cursor": int() as now}]:
            return now == cursor
        case _:
            return False


WATCH: Final = "rossec.watchGraph"


def facts(graph: Graph, access_control: AccessControl, caller: Caller) -> Iterator[Fact | None]:
    # What `caller` may see of the graph, as in `getSystemState` and similar queries. None for each name and
    # node that it may not see.
    for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE):
        for key, names in shown_entries(graph, caller, kind):
            shown = access_control.visible_nodes(caller, key, names)
            yield from ((kind.value, key, name) for name in shown)
            if not shown:
                yield None
            elif kind is Kind.SERVICE:
                yield "provider", key, graph.service_uri(key) or ""
            elif (type_name := publisher_views.topic_type(graph, caller, key)) != ANY_TYPE:
                yield "type", key, type_name
    seen = set[str]()
    for node in graph.nodes():
        if access_control.is_node_visible(caller, node.name):
            seen.add(node.name)
            yield "node", node.name, node.uri
        else:
            yield None
    for told in publisher_views.shown_nodes(graph, caller):
        yield None if told is None or told.name in seen else ("node", told.name, told.uri)
