"""A master that keeps answers beside one that keeps none: any calls in any order have equal answers.

Both see the same registrations, parameters, imports, grants, revocations and clock. The callers of the one
speak both forms of calls, so what is given again is compared as they read it.
"""

from copy import deepcopy
from typing import Any, Final

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from ca.errors import HintedError
from grants.model import Right
from rossec.master.api.kept_answers import KeptAnswers
from rossec.master.api.methods import MasterTables
from rossec.master.rights.caller import Caller
from rossec.master.rights.statements import TrustState, enforce, enforcement_steps
from rossec.master.state import imported_facts
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry
from rossec.ros import xmlrpc
from rossec.ros.calls import CallClient, CallServer, value_in
from tests.rossec.master.fakes import call_api, master_api
from tests.support.authority import EnrolledNode, Site

NODES: Final = ("/a", "/b")
REMOTE_NODE: Final = "/remote/lab/x"
READS: Final[tuple[tuple[str, ...], ...]] = (
    ("lookupNode", "/a"),
    ("lookupNode", "/b"),
    ("lookupNode", REMOTE_NODE),
    ("lookupService", "/ns/u"),
    ("getSystemState",),
    ("getTopicTypes",),
    ("getPublishedTopics", ""),
    ("getUri",),
    ("getPid",),
    ("getParam", "/p"),
    ("hasParam", "/p/q"),
    ("getParam", "/remote/lab/r"),
    ("searchParam", "q"),
    ("getParamNames",),
)
ALL: Final = Right(255)
LAB: Final = imported_facts.Site("lab")
FACTS: Final = (
    ("node", "/x", "http://far:1/"),
    ("publisher", "/far", "/x"),
    ("type", "/far", "std_msgs/String"),
)
names = st.sampled_from(NODES)
rights = st.sampled_from([Right.PARAM_GET, Right.GRAPH | Right.CALL, Right.SUBSCRIBE, ALL])
patterns = st.sampled_from(["/**", "/p/**", "/t", "/ns/**"])


class Side:
    """One master; `kept` is None where nothing is kept."""

    def __init__(self, site: Site, master: EnrolledNode, *, keeps: bool) -> None:
        self.trust = TrustState(site.anchor, master.credentials.signer, site.revocations(), lambda _: None)
        self.registry = Registry()
        self.imports = Imports(self.registry)
        self.trust.domains.own_sites = self.imports.own_sites
        tables = MasterTables("/master", self.trust, self.imports)
        self.api = master_api(self.registry, self.trust, imports=self.imports, parameters=tables.parameters)
        self.kept = KeptAnswers(tables) if keeps else None
        self.found = 0

    def caller(self, node: EnrolledNode, now: int) -> tuple[Caller, int]:
        return self.trust.caller(node.identity, now), now

    def call(self, node: EnrolledNode, now: int, method: str, params: tuple[object, ...]) -> Any:
        return call_api(self.api, method, params, self.caller(node, now)[0], now)

    def take_list(self, data: bytes, now: int) -> None:
        self.trust.update(data, now)
        for step in enforcement_steps(self.registry):
            enforce(self.registry, self.trust, step, now)


class Connection:
    """A caller of the side that keeps answers, as `CallLoop` and `CallAnswers` serve it."""

    def __init__(self, side: Side, node: EnrolledNode, *, compact: bool, now: int) -> None:
        self.side, self.node = side, node
        self.client, self.server = CallClient("m", compact=compact), CallServer(compact=compact)
        self.ask(now, "getPid")
        assert self.client.is_compact is compact

    def ask(self, now: int, method: str, *params: object) -> Any:
        side, kept, node = self.side, self.side.kept, self.node
        assert kept is not None
        request = self.server.take(self.client.request(method, (node.name, *params)))
        assert isinstance(request, bytes)
        data = self.server.call_bytes(request)
        found = (
            None if data is None else kept.find(node.thumbprint, data, lambda: side.caller(self.node, now))
        )
        if found is not None:
            side.found += 1
            return value_in(self.client.take(self.server.respond_again(found)))
        call = self.server.load(request)
        outcome = side.call(node, now, call.method, call.params)
        answer = self.server.respond(outcome.answer)
        if data is not None and side.api.methods[method].kept and not outcome.events:
            kept.keep(side.caller(node, now)[0], now, data, answer)
        return value_in(self.client.take(answer))


class TwoMasters(RuleBasedStateMachine):
    def __init__(self) -> None:
        super().__init__()
        self.site = Site(now=1_800_000_000)
        self.now = self.site.now
        master = self.site.enroll("/master")
        self.nodes = {name: self.site.enroll(name) for name in NODES}
        self.keeping = Side(self.site, master, keeps=True)
        self.plain = Side(self.site, master, keeps=False)
        self.sides = self.keeping, self.plain
        self.signed: list[bytes] = []
        self.revoked: list[bytes | EnrolledNode] = []

    @initialize()
    def begin(self) -> None:
        self.load()
        self.connections = [
            Connection(self.keeping, node, compact=compact, now=self.now)
            for node in self.nodes.values()
            for compact in (True, False)
        ]
        self.sign("/a", "/**", ALL, 20)
        self.sign("/b", "/**", Right.GRAPH, 2)

    def both(self, name: str, method: str, *params: object) -> None:
        """A call that is never kept, at both masters."""
        answers = []
        for side in self.sides:
            try:
                outcome = side.call(self.nodes[name], self.now, method, (name, *deepcopy(params)))
                answers.append(outcome.answer[:2])
            except HintedError:
                answers.append(None)
        assert answers[0] == answers[1]

    @rule(name=names, pattern=patterns, held=rights, lifetime=st.integers(1, 5))
    def sign(self, name: str, pattern: str, held: Right, lifetime: int) -> None:
        self.site.now = self.now
        token = self.site.grant(self.nodes[name], {pattern: held}, lifetime=lifetime)
        self.signed.append(token)
        self.both(name, "rossec.presentGrants", [token])

    @rule(pick=st.integers(0, 99))
    def revoke_grant(self, pick: int) -> None:
        self.revoked.append(self.signed[pick % len(self.signed)])
        self.load()

    @rule(name=names)
    def revoke_identity(self, name: str) -> None:
        self.revoked.append(self.nodes[name])
        self.load()

    def load(self) -> None:
        self.site.now = self.now
        data = self.site.revoke(*self.revoked)
        for side in self.sides:
            side.take_list(data, self.now)

    @rule(seconds=st.integers(1, 4))
    def time_passes(self, seconds: int) -> None:
        self.now += seconds

    @rule()
    def the_clock_is_set_back(self) -> None:
        self.now -= 1

    @rule(
        name=names,
        method=st.sampled_from(["registerPublisher", "registerSubscriber"]),
        topic=st.sampled_from(["/t", "/far", "/remote/lab/t"]),
    )
    def register(self, name: str, method: str, topic: str) -> None:
        self.both(name, method, topic, "std_msgs/String", f"http://host{name[1:]}:1/")

    @rule(name=names)
    def provide(self, name: str) -> None:
        self.both(name, "registerService", "/ns/u", f"rosrpc://host{name[1:]}:9", f"http://host{name[1:]}:1/")

    @rule(name=names)
    def unregister(self, name: str) -> None:
        self.both(name, "unregisterPublisher", "/t", f"http://host{name[1:]}:1/")
        self.both(name, "unregisterService", "/ns/u", f"rosrpc://host{name[1:]}:9")

    @rule(name=names, key=st.sampled_from(["/p", "/p/q", "/ns/r"]), value=st.sampled_from([1, {"q": 2}, {}]))
    def set_parameter(self, name: str, key: str, value: Any) -> None:
        self.both(name, "setParam", key, value)

    @rule(name=names, key=st.sampled_from(["/p", "/p/q"]))
    def delete_parameter(self, name: str, key: str) -> None:
        self.both(name, "deleteParam", key)

    @rule(facts=st.sets(st.sampled_from(FACTS)), whole=st.booleans())
    def import_facts(self, facts: set[tuple[str, str, str]], whole: bool) -> None:
        for side in self.sides:
            side.imports.apply(LAB, sorted(facts), [], whole=whole)

    @rule()
    def drop_site(self) -> None:
        for side in self.sides:
            side.imports.drop(LAB.label)

    @rule(tree=st.sampled_from([{"r": 1}, {"r": 2}, {}]))
    def mirror(self, tree: dict[str, object]) -> None:
        for side in self.sides:
            side.imports.mirrors.replace(LAB, deepcopy(tree))

    @rule()
    def drop_mirror(self) -> None:
        for side in self.sides:
            side.imports.mirrors.drop(LAB.label)

    @invariant()
    def answers_are_equal(self) -> None:
        for connection in tuple(getattr(self, "connections", ())):
            for method, *params in READS:
                node = connection.node
                try:
                    outcome = self.plain.call(node, self.now, method, (node.name, *params))
                except HintedError:  # revoked: its connection would be closed
                    self.is_refused(connection, method, *params)
                    self.connections.remove(connection)
                    break
                expected = xmlrpc.load_response(xmlrpc.dump_response(outcome.answer))
                for _ in range(2):
                    assert connection.ask(self.now, method, *params) == expected, (node.name, method, params)

    def is_refused(self, connection: Connection, method: str, *params: object) -> None:
        try:
            answer = connection.ask(self.now, method, *params)
        except HintedError:
            return
        raise AssertionError(answer)

    def teardown(self) -> None:
        if hasattr(self, "connections"):
            assert self.keeping.found > 0  # or nothing was compared


TestTwoMasters = TwoMasters.TestCase
TestTwoMasters.settings = settings(
    max_examples=25,
    stateful_step_count=20,
    derandomize=True,
    deadline=None,
    suppress_health_check=list(HealthCheck),
)
