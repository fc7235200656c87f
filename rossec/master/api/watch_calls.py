"""Watching the graph: the whole state in the first answer, then only the changes. Pure.

The state is a set of facts, so a change is two sets, and all changes between two calls of a watcher
are sent as one. What each watcher was sent is stored here, without what it may not see. Nothing is
queued: a slow watcher is updated less often, one without a stored view is sent everything. An
answer is bounded; `more` says that the rest follows at once.
"""

from collections import OrderedDict
from collections.abc import Iterator
from itertools import count
from typing import Final, TypeAlias

from rossec.master.api import arguments as arg
from rossec.master.api.methods import CallRequest, Method, Methods, Reply, Steps
from rossec.master.rights.access_rules import AccessControl
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import ANY_TYPE, Kind, Registry

WATCH: Final = "rossec.watchGraph"
BATCH: Final = 1024  # facts in one answer
MAX_VIEWS: Final = 4  # stored for one identity
_START: Final = 0  # the cursor of a watcher without state

Fact: TypeAlias = tuple[str, str, str]
"""Kind, name and value: `("publisher", "/scan", "/laser")`, `("type", "/scan", "pkg/Type")`,
`("provider", "/reset", "rosrpc://...")`, `("node", "/laser", "http://...")`."""

View: TypeAlias = frozenset[Fact]


def facts(
    registry: Registry, access_control: AccessControl, caller: Caller
) -> Iterator[Fact | None]:
    """What `caller` may see of the graph, as in `getSystemState` and similar queries.

    None for each name and node that it may not see.
    """
    for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE):
        for key, names in registry.entries(kind):
            shown = access_control.visible_nodes(caller, key, names)
            yield from ((kind.value, key, name) for name in shown)
            if shown and kind is Kind.SERVICE:
                yield "provider", key, registry.service_uri(key) or ""
            elif shown and registry.topic_type(key) != ANY_TYPE:
                yield "type", key, registry.topic_type(key)
            elif not shown:
                yield None
    for node in tuple(registry.nodes()):
        yield (
            ("node", node.name, node.uri)
            if access_control.is_node_visible(caller, node.name)
            else None
        )


class WatchCalls:
    """The call by which a node watches the graph.

    Args:
        instance: identifies this run of the master: cursors start again after a restart.
    """

    def __init__(self, registry: Registry, access_control: AccessControl, instance: str) -> None:
        self._registry = registry
        self._access_control = access_control
        self._instance = instance
        self._cursors = count(_START + 1)
        self._views: OrderedDict[bytes, OrderedDict[int, View]] = OrderedDict()

    def methods(self) -> Methods:
        """The entry of the method table."""
        checks = (arg.text("instance"), arg.number("cursor"))
        return {WATCH: Method(checks, {}, self._watch)}

    def keep_only(self, thumbprints: frozenset[bytes]) -> None:
        """Discard the views of all other keys."""
        for key in self._views.keys() - thumbprints:
            del self._views[key]

    def _watch(self, request: CallRequest) -> Steps:
        seen, at_once = set[Fact](), request.caller.names_per_yield
        found = facts(self._registry, self._access_control, request.caller)
        for checked, fact in enumerate(found, 1):
            if fact is not None:
                seen.add(fact)
            if not checked % at_once:
                yield
        return self._changes(request, frozenset(seen))

    def _changes(self, request: CallRequest, now: View) -> Reply:
        instance, cursor = request.arguments[1:3]
        views = self._views.setdefault(request.caller.thumbprint, OrderedDict())
        cursor = cursor if isinstance(cursor, int) and instance == self._instance else _START
        known = views.get(cursor)
        old = frozenset() if known is None else known
        added, removed = sorted(now - old), sorted(old - now)
        sent_added, sent_removed = added[:BATCH], removed[:BATCH]
        if known is None or added or removed:
            views.pop(cursor, None)
            cursor = next(self._cursors)
            views[cursor] = (old | frozenset(sent_added)) - frozenset(sent_removed)
            if len(views) > MAX_VIEWS:
                views.popitem(last=False)
        answer: dict[str, object] = {
            "instance": self._instance,
            "version": self._registry.version % (1 << 31),  # XML-RPC's integers end there
            "cursor": cursor,
            "whole": known is None,
            "more": len(added) > BATCH or len(removed) > BATCH,
            "added": [list(fact) for fact in sent_added],
            "removed": [list(fact) for fact in sent_removed],
        }
        return Reply(answer, "state of the graph")


def is_unchanged(answer: object) -> bool:
    """Whether an answer to the call contains no change."""
    match answer:
        case [1, _, {"whole": False, "added": [], "removed": []}]:
            return True
        case _:
            return False
