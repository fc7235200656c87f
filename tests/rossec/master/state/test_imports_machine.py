"""Three masters that follow each other, as a state machine: registrations, restarts, partitions.

The oracle is the union of what is registered, computed directly: after every master has heard of
every other, each view is its own registrations and the others' own, and no fact occurs twice.
"""

from collections import Counter
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from grants.decision import Reach
from rossec.master.api.graph_calls import WATCH
from rossec.master.api.site_calls import FOLLOW
from rossec.master.rights.caller import Caller
from rossec.master.state.imported_facts import Site
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Kind, NodeRef, PublishersChanged, Registry
from rossec.participant.registrations import GraphView
from tests.rossec.master.fakes import FakeStatements, call_api, master_api, refuse

LABELS = ("a", "b", "c")
TOPICS = ("/t0", "/t1")
TYPE = "std_msgs/String"

Fact = tuple[str, str, str]


def own_master(label: str) -> Caller:
    return Caller(f"/master/{label}", label.encode(), Reach(()), refuse, is_own_master=True)


class Master:
    """One master, with what its followers know of the others, and what its subscribers know."""

    def __init__(self, label: str) -> None:
        self.label = label
        self.runs = 0
        self.start()

    def start(self) -> None:
        self.runs += 1
        self.registry = Registry()
        self.imports = Imports(self.registry)
        self.imports.demand.ask_everything(1 << 40)
        self.api = master_api(
            self.registry,
            FakeStatements(),
            name="/master",
            uri="http://m:1/",
            pid=7,
            instance=f"{self.label}{self.runs}",
            imports=self.imports,
        )
        self.views = {label: GraphView() for label in LABELS if label != self.label}
        self.told: dict[str, tuple[str, ...]] = {}

    def node(self, number: int) -> NodeRef:
        name, port = f"/{self.label}{number}", 1000 * (1 + LABELS.index(self.label)) + number
        return NodeRef(name, f"http://10.0.0.1:{port}/", name.encode())

    def take(self, events: list[Any]) -> None:
        for event in events:
            if isinstance(event, PublishersChanged):
                self.told[event.topic] = event.publisher_uris

    def follow(self, other: "Master") -> None:
        """One answer, gathered until it is complete."""
        view, known = self.views[other.label], self.views[other.label].facts
        more, who = True, own_master(self.label)
        while more:
            params = [who.name, *view.next_params, []]
            answer: Any = call_api(other.api, FOLLOW, params, who, 0).answer
            assert answer[0] == 1, answer
            more = view.take(answer[2]).more
        whole = set(view.facts)
        self.take([*self.imports.apply(Site(other.label), whole - known, known - whole)])

    def own_facts(self) -> Counter[Fact]:
        found = Counter[Fact]()
        for kind in (Kind.PUBLISHER, Kind.SUBSCRIBER, Kind.SERVICE):
            for key, nodes in self.registry.entries(kind):
                found.update((kind.value, key, node) for node in nodes)
        return found

    def seen(self) -> Counter[Fact]:
        """What a tool sees."""
        who = Caller("/tool", b"tool", Reach(()), refuse, is_authority=True)
        answer: Any = call_api(self.api, WATCH, [who.name, "", 0], who, 0).answer
        facts: list[Fact] = [(kind, key, value) for kind, key, value in answer[2]["added"]]
        return Counter(each for each in facts if each[0] in {kind.value for kind in Kind})


def expected(master: Master, others: list[Master]) -> set[Fact]:
    """Own and others' own; a service has one provider: the own, or that of the lowest label."""
    found = set(master.own_facts())
    for other in sorted(others, key=lambda each: each.label):
        for kind, key, node in other.own_facts():
            provided = any(fact[:2] == ("service", key) for fact in found)
            if kind != "service" or not provided:
                found.add((kind, key, f"/remote/{other.label}{node}"))
    return found


masters = st.sampled_from(LABELS)
numbers = st.integers(0, 1)
topics = st.sampled_from(TOPICS)


class Mesh(RuleBasedStateMachine):
    @initialize()
    def start(self) -> None:
        self.masters = {label: Master(label) for label in LABELS}
        self.cut = set[str]()

    @rule(at=masters, number=numbers, topic=topics)
    def publish(self, at: str, number: int, topic: str) -> None:
        master = self.masters[at]
        master.take([*master.registry.register_publisher(topic, TYPE, master.node(number))])

    @rule(at=masters, number=numbers, topic=topics)
    def unpublish(self, at: str, number: int, topic: str) -> None:
        master = self.masters[at]
        done = master.registry.unregister(Kind.PUBLISHER, topic, master.node(number))
        master.take([*done[1]])

    @rule(at=masters, number=numbers, topic=topics)
    def subscribe(self, at: str, number: int, topic: str) -> None:
        master = self.masters[at]
        master.take([*master.registry.register_subscriber(topic, "*", master.node(number))])
        master.told[topic] = tuple(master.registry.publisher_uris(topic))  # the answer

    @rule(at=masters, number=numbers)
    def provide(self, at: str, number: int) -> None:
        master = self.masters[at]
        uri = master.node(number).uri.replace("http", "rosrpc").rstrip("/")
        master.registry.register_service("/s", f"{uri}9", master.node(number))

    @rule(at=masters, number=numbers)
    def leave(self, at: str, number: int) -> None:
        master = self.masters[at]
        master.take([*master.registry.remove_node(master.node(number).name)])

    @rule(at=masters)
    def restart(self, at: str) -> None:
        self.masters[at].start()

    @rule(at=masters)
    def partition(self, at: str) -> None:
        """Nobody hears of this master, and it hears of nobody; its facts stay, marked."""
        self.cut.add(at)
        for label, master in self.masters.items():
            for other in self.masters:
                if other != label and at in (label, other):
                    master.imports.lose(other)

    @rule(at=masters)
    def expire(self, at: str) -> None:
        """A lost master's facts go after a while."""
        if at in self.cut:
            for master in self.masters.values():
                master.take([*master.imports.drop(at)])
                if at in master.views:
                    master.views[at] = GraphView()

    @rule(at=masters, other=masters)
    def hear(self, at: str, other: str) -> None:
        if at != other and not self.cut & {at, other}:
            self.masters[at].follow(self.masters[other])

    @rule()
    def heal(self) -> None:
        self.cut.clear()
        for master in self.masters.values():
            for label in master.views:
                master.follow(self.masters[label])
        self.agree()

    def agree(self) -> None:
        for label, master in self.masters.items():
            seen = master.seen()
            others = [each for name, each in self.masters.items() if name != label]
            assert set(seen) == expected(master, others)
            assert not seen or max(seen.values()) == 1
            for topic in master.registry.keys(Kind.SUBSCRIBER):
                publishers = {
                    uri for each in self.masters.values() for uri in each.registry.uris(Kind.PUBLISHER, topic)
                }
                assert set(master.told[topic]) == publishers
                assert len(master.told[topic]) == len(publishers)

    @invariant()
    def nothing_imported_is_passed_on(self) -> None:
        if hasattr(self, "masters"):
            for master in self.masters.values():
                who = own_master("x")
                answer: Any = call_api(master.api, FOLLOW, [who.name, "", 0, []], who, 0).answer
                values = [each[2] for each in answer[2]["added"]] + [each[1] for each in answer[2]["added"]]
                assert not any(value.startswith("/remote") for value in values)


TestMesh = Mesh.TestCase
TestMesh.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


def test_nothing_grows_with_a_thousand_cycles() -> None:
    first, second = Master("a"), Master("b")
    sizes = list[tuple[int, ...]]()
    for cycle in range(1000):
        second.registry.register_publisher(f"/t{cycle}", TYPE, second.node(0))
        second.registry.register_service(f"/s{cycle}", f"rosrpc://10.0.0.1:{cycle + 1}", second.node(1))
        first.registry.register_subscriber(f"/t{cycle}", "*", first.node(0))
        first.follow(second)
        second.registry.remove_node(second.node(0).name)
        second.registry.remove_node(second.node(1).name)
        first.registry.remove_node(first.node(0).name)
        first.follow(second)
        if not cycle % 100:
            second.start()
            first.follow(second)
            first.take([*first.imports.drop("b")])
            first.views["b"] = GraphView()
        kinds = [len(first.imports.keys(kind)) for kind in Kind]
        facts = sum(each.facts for each in first.imports.sites)
        sizes.append((facts, len(second.api.sites.views), *kinds))
    assert max(sizes) <= (0, 4, 0, 0, 0, 0)


def test_the_nodes_of_one_site_crowd_out_no_other_site(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.master.state.imports.MAX_REGISTERED", 3)
    imports = Imports(Registry())
    crowd = [("node", f"/ghost{n}", f"http://10.0.0.9:{n + 1}/") for n in range(9)]
    crowd += [("publisher", "/pose", f"/ghost{n}") for n in range(9)]
    imports.apply(Site("attic"), crowd, [])
    robot = [("node", "/robot", "http://10.0.0.2:1/"), ("publisher", "/pose", "/robot")]
    imports.apply(Site("kitchen"), robot, [])
    assert len(imports.nodes_of(Kind.PUBLISHER, "/pose")) == 4
    assert "http://10.0.0.2:1/" in imports.publisher_uris("/pose")
    imports.apply(Site("attic"), [], crowd)
    assert imports.publisher_uris("/pose") == ["http://10.0.0.2:1/"]
