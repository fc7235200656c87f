"""A graph with an origin and a gateway, and subscribers of an alias with chosen rights."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

from grants.model import Right
from rossec.master.rights.caller import Caller
from rossec.master.rights.publisher_views import AliasPublishers
from rossec.master.state.graph import Graph
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import NodeRef, PublishersChanged, Registry
from tests.rossec.master.rights.test_caller import visitor_of

T: Final = "std_msgs/String"
ALIAS: Final = "/remote/hospital/pose"
SERVED: Final = "/gateway/hospital/pose"
HOSPITAL: Final = Site("hospital", "hospital")
ORIGIN: Final = "http://10.0.0.2:1/"
POSE: Final = [("node", "/robot", ORIGIN), ("publisher", "/pose", "/robot"), ("type", "/pose", T)]
GATEWAY: Final = NodeRef("/gateway", "http://10.0.0.9:1/", b"/gateway")
SERVED_RIGHT: Final = {SERVED: Right.SUBSCRIBE}
ORIGINS_RIGHT: Final = {"/pose": Right.SUBSCRIBE}


@dataclass
class Serving:
    """The state of a master, without one."""

    registry: Registry = field(default_factory=Registry)
    callers: dict[str, Caller] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.imports = Imports(self.registry)
        self.graph = Graph(self.registry, self.imports)
        self.aliases = AliasPublishers(self.graph, lambda peer, _: self.callers.get(peer.name))

    def rights(
        self, name: str, own: Mapping[str, Right], hospital: Mapping[str, Right] | None = None
    ) -> Caller:
        """Give a node these rights, by own grants and by the hospital's."""
        found = replace(visitor_of(hospital, own), name=name, thumbprint=name.encode())
        self.callers[name] = found
        return found

    def subscribe(
        self, name: str, own: Mapping[str, Right], hospital: Mapping[str, Right] | None = None
    ) -> list[str]:
        """Subscribe the alias; returns what the node is told."""
        who = self.rights(name, own, hospital)
        self.registry.register_subscriber(ALIAS, "*", node(name))
        return self.aliases.tell(who, ALIAS, node(name))

    def serve(self) -> list[PublishersChanged]:
        """The gateway serves the topic."""
        found = self.registry.register_publisher(SERVED, T, GATEWAY)
        return self.updates(found)

    def updates(self, events: Sequence[object]) -> list[PublishersChanged]:
        """What is delivered for these events of the registry or the imports."""
        changed = [event for event in events if isinstance(event, PublishersChanged)]
        return [update for event in changed for update in self.aliases.updates(event, 0)]


def node(name: str) -> NodeRef:
    """A node of the own domain."""
    return NodeRef(name, f"http://10.0.1.{len(name)}:1/", name.encode())
