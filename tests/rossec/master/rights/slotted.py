"""A master's table with somebody who may know who publishes only to a slot of a minute."""

from collections.abc import Iterable
from typing import Any, Final

from grants.decision import Reach
from grants.model import Permission, Restriction, Right
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import MasterTables
from rossec.master.rights.caller import Caller
from rossec.master.state.imports import Imports
from rossec.master.state.registry import PublishersChanged, Registry
from tests.rossec.master.fakes import FakeStatements, call_api, caller, refuse

FORWARDED_PORT: Final = "/door"
TYPE: Final = "std_msgs/Bool"
SLOT: Final = 60
URI: Final = "http://10.0.0.5:1/"
IN_SLOTS: Final = Permission(FORWARDED_PORT, Right.SUBSCRIBE, Restriction(slot=SLOT))
WATCHES: Final = Permission("/master", Right.GRAPH)


def with_permissions(name: str, *held: Permission) -> Caller:
    """A caller with these permissions."""
    return Caller(name, name.encode(), Reach(held), refuse)


class SlottedMaster:
    """Calls by `/watcher`, which is in slots, `/witness`, which is not, and the sensor."""

    def __init__(self) -> None:
        self.registry = Registry()
        self.statements = FakeStatements()
        tables = MasterTables("/master", self.statements, Imports(self.registry))
        self.graph, self.aliases = tables.graph, tables.aliases
        self.api = MasterApi(tables, uri="http://m:1/", pid=7)
        self.watcher = with_permissions("/watcher", IN_SLOTS, WATCHES)
        self.witness = caller("/witness", {FORWARDED_PORT: Right.SUBSCRIBE})
        self.sensor = caller("/sensor", {FORWARDED_PORT: Right.PUBLISH})
        for each in (self.watcher, self.witness, self.sensor):
            self.statements.callers[each.name] = each
        self.sent: dict[str, list[tuple[int, list[str]]]] = {}

    def ask(self, who: Caller, method: str, *params: object, now: int) -> Any:
        """The value of the answer; what it changes is sent."""
        outcome: Any = call_api(self.api, method, [who.name, *params], who, now)
        self.deliver(outcome.events, now)
        return outcome.answer[2]

    def deliver(self, events: Iterable[object], now: int) -> None:
        """Send what these events are about."""
        for event in events:
            if isinstance(event, PublishersChanged):
                self._send(self.aliases.updates(event, now), now)

    def maintain(self, now: int) -> None:
        """A round of maintenance."""
        for changes in self.aliases.all_changes(now):
            self._send(changes, now)

    def publish(self, now: int, uri: str = URI) -> None:
        """The sensor registers."""
        self.ask(self.sensor, "registerPublisher", FORWARDED_PORT, TYPE, uri, now=now)

    def end(self, now: int, uri: str = URI) -> None:
        """The sensor ends."""
        self.ask(self.sensor, "unregisterPublisher", FORWARDED_PORT, uri, now=now)

    def subscribe(self, who: Caller, now: int) -> list[str]:
        """Subscribe; returns the publishers."""
        found: list[str] = self.ask(
            who, "registerSubscriber", FORWARDED_PORT, "*", f"http://{who.name[1:]}:1/", now=now
        )
        return found

    def answers(self, who: Caller, now: int) -> dict[str, object]:
        """Everything that the master tells of the graph."""
        calls = (
            ("getSystemState",),
            ("getTopicTypes",),
            ("getPublishedTopics", ""),
            ("lookupNode", "/sensor"),
            ("rossec.watchGraph", "", 0),
        )
        found = {method: self.ask(who, method, *params, now=now) for method, *params in calls}
        watched = found["rossec.watchGraph"]
        if isinstance(watched, dict):
            watched.pop("cursor", None)
        return {name: repr(_plain(value)) for name, value in found.items()}

    def _send(self, updates: Iterable[PublishersChanged], now: int) -> None:
        for update in updates:
            for node in update.subscribers:
                self.sent.setdefault(node.name, []).append((now, [*update.publisher_uris]))


def _plain(value: object) -> object:
    return [_plain(each) for each in value] if isinstance(value, list) else value
