"""Registry, grants and revocation together: any calls in any order.

Invariants: once a revocation is loaded and enforced, nothing revoked appears in any answer; and no
sequence of calls leaves a node with a registration it has no right to, or shows it one. Only the
network and the clock are fake: grants, lists and tickets are signed.
"""

from copy import deepcopy
from typing import Any, Final

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from ca.encoding import decode, encode
from ca.errors import HintedError
from grants.document import grant_id, peek
from grants.model import Right
from grants.token import unpack
from rossec.master.rights.caller import VISIBILITY_RIGHTS
from rossec.master.rights.renewals import TicketSigner
from rossec.master.rights.statements import TrustState, enforce, enforcement_steps
from rossec.master.state.registry import Kind, NodeRef, PublishersChanged, Registry, ShutdownNode
from rossec.participant.registrations import GraphView
from tests.rossec.master.fakes import call_api, master_api
from tests.support.authority import EnrolledNode, Site

NODES: Final = ("/a", "/b", "/watcher")
TOPICS: Final = ("/t", "/ns/u")
PARAMETERS: Final = ("/p", "/p/q", "/ns/r")
MAX_PATTERN_MATCHES: Final = ("/**", "/t", "/ns/**", "/p")
RIGHTS: Final = (
    Right.PUBLISH,
    Right.SUBSCRIBE | Right.PROVIDE,
    Right.PARAM_GET | Right.PARAM_SET,
    Right.CALL | Right.GRAPH,
    Right(127),
    Right(255),
)
HOUR: Final = 3600

NEEDED: Final = {
    "registerPublisher": (Kind.PUBLISHER, Right.PUBLISH),
    "registerSubscriber": (Kind.SUBSCRIBER, Right.SUBSCRIBE),
    "registerService": (Kind.SERVICE, Right.PROVIDE),
}
names = st.sampled_from(NODES)
topics = st.sampled_from(TOPICS)
keys = st.sampled_from(PARAMETERS)
picks = st.integers(0, 1 << 16)


class Master(RuleBasedStateMachine):
    """The pure master, and a simple model of the grants of each node."""

    def __init__(self) -> None:
        super().__init__()
        self.site = Site(now=1_800_000_000)
        self.now = self.site.now
        self.registered_nodes: dict[str, EnrolledNode] = {name: self.site.enroll(name) for name in NODES}
        self.master = self.site.enroll("/master")
        signer = self.master.credentials.signer
        delegate = TicketSigner(self.site.anchor, signer)
        delegate.take(self.site.delegation(self.master, lifetime=1000 * HOUR))
        self.trust = TrustState(self.site.anchor, signer, self.site.revocations(), lambda _: None, delegate)
        self.registry = Registry()
        self.api = master_api(
            self.registry, self.trust, name="/master", uri="http://m:1/", pid=1, instance="x"
        )
        self.signed: list[tuple[str, bytes]] = []
        self.presented: dict[str, dict[bytes, bytes]] = {name: {} for name in NODES}
        self.revoked: list[bytes | EnrolledNode] = []
        self.dead: set[str] = set()  # names whose key is revoked
        self.view = GraphView()

    # --- calls, as the server makes them ---

    def call(self, name: str, method: str, *params: object) -> Any:
        """Answer of the master, or None for a revoked caller, whose connection is closed."""
        try:
            caller = self.trust.caller(self.registered_nodes[name].identity, self.now)
        except HintedError:
            assert name in self.dead
            return None
        assert name not in self.dead
        outcome = call_api(self.api, method, [name, *params], caller, self.now)
        for event in outcome.events:
            assert not isinstance(event, ShutdownNode)
            if isinstance(event, PublishersChanged):
                assert not self.who(event.subscribers) & self.dead
        return outcome.answer

    @staticmethod
    def who(nodes: tuple[NodeRef, ...]) -> set[str]:
        return {node.name for node in nodes}

    def uri(self, name: str) -> str:
        return f"http://host{name.replace('/', '-')}:1/"

    def may(self, name: str, right: Right, key: str) -> bool:
        """Whether, in the model, a grant that the node has presented covers the right."""
        if name in self.dead:
            return False
        gone = {grant_id(item) for item in self.revoked if isinstance(item, bytes)}
        for token, ends in self.presented[name].items():
            grant = peek(unpack(token).grant)
            valid = grant.not_before <= self.now < int.from_bytes(ends) and grant.id not in gone
            if valid and any(permission.covers(right, key) for permission in grant.permissions):
                return True
        return False

    # --- rules ---

    @initialize(first=st.sampled_from(RIGHTS), second=st.sampled_from(RIGHTS))
    def begin(self, first: Right, second: Right) -> None:
        self.trust.update(self.site.revoke(), self.now)
        for name, rights in zip(NODES, (first, second, Right.GRAPH), strict=True):
            self.sign(name, "/**", rights, 10 * HOUR)
        self.register("/a", "/t", "registerPublisher")
        self.register("/b", "/t", "registerSubscriber")
        self.register("/b", "/ns/u", "registerService")

    @rule(
        name=names,
        pattern=st.sampled_from(MAX_PATTERN_MATCHES),
        rights=st.sampled_from(RIGHTS),
        lifetime=st.sampled_from([HOUR // 2, 10 * HOUR]),
    )
    def sign(self, name: str, pattern: str, rights: Right, lifetime: int) -> None:
        self.site.now = self.now
        rights_of = {pattern: rights}
        if name == "/watcher":
            rights_of["/master"] = Right.GRAPH
        token = self.site.grant(self.registered_nodes[name], rights_of, lifetime=lifetime, cap=20 * HOUR)
        self.signed.append((name, token))
        self.present(len(self.signed) - 1, None)

    @precondition(lambda self: self.signed)
    @rule(pick=picks, thief=st.none() | names)
    def present(self, pick: int, thief: str | None) -> None:
        owner, token = self.signed[pick % len(self.signed)]
        presenter = thief or owner
        answer = self.call(presenter, "rossec.presentGrants", [token])
        if answer is not None and presenter == owner:
            self.presented[owner].setdefault(token, peek(token).expires.to_bytes(8))

    @precondition(lambda self: self.signed)
    @rule(pick=picks)
    def renew(self, pick: int) -> None:
        name, token = self.signed[pick % len(self.signed)]
        answer = self.call(name, "rossec.renewGrants", [token])
        if answer is None:
            return
        [renewed] = answer[2]
        if renewed:
            assert token not in self.revoked
            ends = min(self.now - 5 + HOUR, peek(token).cap)
            self.presented[name][token] = max(self.presented[name].get(token, b""), ends.to_bytes(8))

    @rule(name=names, topic=topics, method=st.sampled_from(sorted(NEEDED)))
    def register(self, name: str, topic: str, method: str) -> None:
        kind, right = NEEDED[method]
        middle = "rosrpc://h:9" if kind is Kind.SERVICE else "std_msgs/String"
        answer = self.call(name, method, topic, middle, self.uri(name))
        if answer is not None:
            assert (answer[0] == 1) == self.may(name, right, topic), answer

    @rule(name=names, victim=names, topic=topics)
    def impersonate(self, name: str, victim: str, topic: str) -> None:
        caller = self.trust.caller_of(self.registered_nodes[name].identity, self.now)
        if name == victim or caller is None:
            return
        uri = self.uri(victim)
        for method, *params in (
            ("registerPublisher", topic, "*", uri),
            ("unregisterPublisher", topic, uri),
            ("setParam", "/p", 1),
        ):
            answer: Any = call_api(self.api, method, [victim, *params], caller, self.now).answer
            # An administrator may unregister a node's entries, and act as it in no other call.
            cleans_up = method == "unregisterPublisher" and self.may(name, Right.ADMIN, victim)
            assert answer[0] == -1 or cleans_up

    @rule(name=names, key=keys, value=st.sampled_from([1, {"q": 2}, {}]))
    def set_parameter(self, name: str, key: str, value: Any) -> None:
        answer = self.call(name, "setParam", key, deepcopy(value))  # each call has its own value
        if answer is not None and answer[0] == 1:
            assert self.may(name, Right.PARAM_SET, key)

    @rule(name=names, key=keys)
    def subscribe_parameter(self, name: str, key: str) -> None:
        answer = self.call(name, "subscribeParam", self.uri(name), key)
        if answer is not None and answer[0] == 1 and not isinstance(answer[2], dict):
            assert self.may(name, Right.PARAM_GET, key)

    @rule(name=names, topic=topics)
    def unregister(self, name: str, topic: str) -> None:
        self.call(name, "unregisterPublisher", topic, self.uri(name))
        self.call(name, "unregisterSubscriber", topic, self.uri(name))

    @rule(name=names, topic=topics)
    def several_at_once(self, name: str, topic: str) -> None:
        calls = [
            {"methodName": "registerPublisher", "params": [name, topic, "*", self.uri(name)]},
            {"methodName": "getParam", "params": [name, "/p"]},
            {"methodName": "shutdown", "params": [name, "why"]},
        ]
        try:
            caller = self.trust.caller(self.registered_nodes[name].identity, self.now)
        except HintedError:
            return
        answers: Any = call_api(self.api, "system.multicall", [calls], caller, self.now).answer
        rights = ((Right.PUBLISH, topic), (Right.PARAM_GET, "/p"), (Right.ADMIN, "/master"))
        for [answer], (right, key) in zip(answers, rights, strict=True):
            assert not answer[1].startswith("rossec: ") or answer[0] == -1
            if answer[0] == 1:
                assert self.may(name, right, key)

    @rule(hours=st.integers(1, 8))
    def time_passes(self, hours: int) -> None:
        self.now += hours * HOUR // 4
        self.load()

    @precondition(lambda self: self.signed)
    @rule(pick=picks)
    def revoke_grant(self, pick: int) -> None:
        self.revoked.append(self.signed[pick % len(self.signed)][1])
        self.load()

    @precondition(lambda self: len(self.dead) < 2)
    @rule(name=names)
    def revoke_identity(self, name: str) -> None:
        self.revoked.append(self.registered_nodes[name])
        self.dead.add(name)
        self.load()

    @precondition(lambda self: self.dead)
    @rule()
    def enroll_again(self) -> None:
        """A new key under an old name has no grants."""
        name = min(self.dead)
        self.site.now = self.now
        self.registered_nodes[name] = self.site.enroll(name)
        self.dead.discard(name)
        self.presented[name] = {}
        self.signed = [item for item in self.signed if item[0] != name]

    @rule()
    def an_older_list(self) -> None:
        """A list that is older or signed by another key does not undo a revocation."""
        caller = self.trust.caller_of(self.registered_nodes["/a"].identity, self.now)
        if caller is not None:
            forged = Site(now=self.now).revoke()
            answer: Any = call_api(
                self.api, "rossec.updateRevocations", ["/a", forged], caller, self.now
            ).answer
            assert answer[0] == -1

    def load(self) -> None:
        """A list arrives and is enforced, as the server does at once and every ten seconds."""
        self.site.now = self.now
        self.trust.update(self.site.revoke(*self.revoked, lifetime=1000 * HOUR), self.now)
        for step in enforcement_steps(self.registry):
            for event in enforce(self.registry, self.trust, step, self.now):
                assert isinstance(event, PublishersChanged)
                assert not self.who(event.subscribers) & self.dead

    # --- invariants ---

    @invariant()
    def nothing_registered_without_a_right(self) -> None:
        for method, (kind, right) in NEEDED.items():
            for key, nodes in self.registry.entries(kind):
                for name in nodes:
                    assert self.may(name, right, key), (method, name, key)
        for node in self.registry.nodes():
            assert node.thumbprint == self.registered_nodes[node.name].thumbprint

    @invariant()
    def nobody_sees_what_it_may_not(self) -> None:
        for name in NODES:
            state = self.call(name, "getSystemState")
            if state is None:
                continue
            for key, nodes in (entry for kind in state[2] for entry in kind):
                assert not set(nodes) & self.dead
                seen = any(self.may(name, right, key) for right in VISIBILITY_RIGHTS)
                assert seen or nodes == [name]
            shown = self.call(name, "getParamNames")[2]
            assert all(self.may(name, Right.PARAM_GET, key) for key in shown)
            self.sees_no_dead_node(name)

    def sees_no_dead_node(self, name: str) -> None:
        for dead in self.dead:
            assert self.call(name, "lookupNode", dead)[0] == -1
        for topic in TOPICS:
            answer = self.call(name, "lookupService", topic)
            if answer[0] == 1:
                assert self.may(name, Right.CALL, topic)
                assert not set(dict(self.registry.entries(Kind.SERVICE))[topic]) & self.dead

    @invariant()
    def the_watcher_sees_the_same(self) -> None:
        answer = self.call("/watcher", "rossec.watchGraph", *self.view.next_params)
        if answer is None or answer[0] != 1:
            return
        assert self.may("/watcher", Right.GRAPH, "/master")
        self.view.take(answer[2])
        state = self.call("/watcher", "getSystemState")[2]
        received = {fact for fact in self.view.facts if fact[0] in {"publisher", "subscriber"}}
        assert received == {
            (kind, key, node)
            for kind, entries in zip(("publisher", "subscriber"), state[:2], strict=True)
            for key, nodes in entries
            for node in nodes
        }

    @invariant()
    def a_query_shows_no_more_than_the_list(self) -> None:
        answer = self.call("/b", "rossec.trl", encode({}))
        if answer is not None:
            value: Any = decode(answer[2])
            assert set(value[0]) <= self.trust.revoked()


TestMaster = Master.TestCase
TestMaster.settings = settings(
    max_examples=80,
    stateful_step_count=30,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
