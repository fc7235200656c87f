from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.errors import RevocationRefused
from rossec.participant.slave_api import ALIAS_ASKED, NO_TRANSPORT, SlaveApi
from tests.support.site import Site

Call = tuple[object, ...]


class Node:
    """Records the events of the slave API."""

    def __init__(self) -> None:
        self.received: list[Call] = []

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        self.received.append((topic, uris))

    def parameter_changed(self, key: str, value: object) -> None:
        self.received.append((key, value))

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        if params[0] == b"older":
            raise RevocationRefused("older than one seen")
        self.received.append((method, *params, master.name))

    def shutdown_requested(self, reason: str) -> None:
        self.received.append((reason,))

    def topic_endpoint(self) -> tuple[str, int]:
        return "robot.local", 40000

    def describe(self) -> Mapping[str, object]:
        return {
            "getName": "/n",
            "getUri": "http://n:1/",
            "getPid": 7,
            "getMasterUri": "http://m:1",
            "getBusStats": [],
            "getBusInfo": [],
            "getSubscriptions": [["/t", "p/T"]],
            "getPublications": [],
        }


@pytest.fixture(scope="module")
def identity(tmp_path_factory: pytest.TempPathFactory) -> Identity:
    return Site(Path(tmp_path_factory.mktemp("slave")) / "site").identity("/viewer")


@pytest.fixture
def node() -> Node:
    return Node()


async def call(node: Node, peer: Identity, method: str, *params: object) -> object:
    return await SlaveApi(node)(method, params, peer)


MASTER_CALLS: list[Call] = [
    ("publisherUpdate", "/t", ["http://a:1"]),
    ("paramUpdate", "/k", 3),
    ("shutdown", "replaced"),
    ("rossec.revocationUpdate", b"list", b"stamp"),
    ("rossec.domainsUpdate", b"list"),
    ("rossec.foreignRevocationUpdate", "hospital.example", b"list", b"stamp", [b"leaf"]),
    ("getName",),
    ("getUri",),
    ("getPid",),
    ("getMasterUri",),
    ("getBusStats",),
    ("getBusInfo",),
    ("getSubscriptions",),
    ("getPublications",),
]


@pytest.mark.parametrize("given", MASTER_CALLS)
async def test_the_master_may_control_the_node(node: Node, identity: Identity, given: Call) -> None:
    master = replace(identity, name="/master")
    answer = await call(node, master, str(given[0]), "/master", *given[1:])
    assert isinstance(answer, list)
    assert answer[0] == 1


@pytest.mark.parametrize("given", MASTER_CALLS)
async def test_no_other_peer_may_control_the_node(node: Node, identity: Identity, given: Call) -> None:
    for claimed in ("/viewer", "/master"):
        answer = await call(node, identity, str(given[0]), claimed, *given[1:])
        assert isinstance(answer, list)
        assert (answer[0], "for the master alone" in str(answer[1])) == (-1, True)
    assert node.received == []


async def test_calls_of_the_master_reach_the_node(node: Node, identity: Identity) -> None:
    master = replace(identity, name="/master")
    await call(node, master, "publisherUpdate", "/master", "/t", ["http://a:1", 5])
    await call(node, master, "rossec.revocationUpdate", "/master", b"list", b"stamp")
    await call(node, master, "shutdown", "/master", "replaced")
    update = ("rossec.revocationUpdate", b"list", b"stamp", "/master")
    assert node.received == [("/t", ["http://a:1"]), update, ("replaced",)]


async def test_other_updates_of_the_master_reach_the_node(node: Node, identity: Identity) -> None:
    master = replace(identity, name="/master")
    await call(node, master, "rossec.domainsUpdate", "/master", b"list")
    word = ("hospital", b"list", b"stamp", [b"leaf"])
    await call(node, master, "rossec.foreignRevocationUpdate", "/master", *word)
    assert node.received == [
        ("rossec.domainsUpdate", b"list", "/master"),
        ("rossec.foreignRevocationUpdate", *word, "/master"),
    ]
    answer = await call(node, master, "rossec.domainsUpdate", "/master", b"older")
    assert answer == [-1, "rossec: older than one seen", 0]


async def test_the_master_is_who_the_node_calls_so(node: Node, identity: Identity) -> None:
    kitchen = replace(identity, name="/master/kitchen")
    foreign = replace(identity, name="/remote/hospital/master", certified="/master")
    given = ("shutdown", ("/master/kitchen", "x"))
    assert await SlaveApi(node, "/master/kitchen")(*given, kitchen) == [1, "shutdown", 0]
    for master, peer, caller in (
        ("/master", kitchen, "/master/kitchen"),
        ("/master/kitchen", identity, "/viewer"),
        ("/master", foreign, "/master"),
    ):
        answer = await SlaveApi(node, master)("shutdown", (caller, "x"), peer)
        assert answer == [-1, "rossec: shutdown is for the master alone", 0]


async def test_a_relay_of_the_own_domain_learns_the_tcpros_port(node: Node, identity: Identity) -> None:
    for name in ("/relay", "/relay/kitchen"):
        relay = replace(identity, name=name)
        assert await call(node, relay, "rossec.ports", name) == [1, "", [40000]]
    refused = [-1, "rossec: rossec.ports is for a relay alone", []]
    for name in ("/viewer", "/master", "/relay/a/b", "/relays"):
        other = replace(identity, name=name)
        assert await call(node, other, "rossec.ports", name) == refused
        authorized = await SlaveApi(node)("rossec.ports", (name,), other, authorized=True)
        assert authorized == refused
    foreign = replace(identity, name="/remote/hospital/relay", certified="/relay")
    assert await call(node, foreign, "rossec.ports", "/relay") == refused


@pytest.mark.parametrize(
    ("params", "said"),
    [
        ((), "missing required caller_id"),
        (("/viewer",), "caller_id is not /relay"),
        (("/relay", 1), "bad call arity"),
    ],
    ids=["nobody", "another", "more"],
)
async def test_a_relay_asks_in_its_own_name_alone(
    node: Node, identity: Identity, params: Call, said: str
) -> None:
    answer = await call(node, replace(identity, name="/relay"), "rossec.ports", *params)
    assert isinstance(answer, list)
    assert (answer[0], said in str(answer[1]), answer[2]) == (-1, True, [])


async def test_any_node_may_call_request_topic(node: Node, identity: Identity) -> None:
    asked = "requestTopic", "/viewer", "/whatever"
    assert await call(node, identity, *asked, [["TCPROS"]]) == [1, "ready", ["TCPROS", "robot.local", 40000]]


@pytest.mark.parametrize("protocols", [[], [["UDPROS", b"", "h", 1, 1500]], ["TCPROS"]])
async def test_only_tcpros_is_offered(node: Node, identity: Identity, protocols: list[object]) -> None:
    answer = await call(node, identity, "requestTopic", "/viewer", "/t", protocols)
    assert answer == [-1, NO_TRANSPORT, []]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("requestTopic", "/other", "/t", []), "caller_id is not /viewer"),
        (("requestTopic", "/viewer", "/t"), "bad call arity"),
        (("requestTopic", "/viewer", 7, []), "bad call arity or types"),
        (("requestTopic",), "missing required caller_id parameter"),
        (("requestTopic", 7), "caller_id must be a string"),
        (("format", "/viewer"), "no such method"),
    ],
)
async def test_malformed_calls_are_refused(node: Node, identity: Identity, given: Call, said: str) -> None:
    answer = await call(node, identity, str(given[0]), *given[1:])
    assert isinstance(answer, list)
    assert (answer[0], said in str(answer[1])) == (-1, True)


async def test_a_refused_list_is_reported_in_the_answer(node: Node, identity: Identity) -> None:
    master = replace(identity, name="/master")
    answer = await call(node, master, "rossec.revocationUpdate", "/master", b"older", b"")
    assert answer == [-1, "rossec: older than one seen", 0]


async def test_an_anonymous_node_may_use_names_its_certificate_covers(node: Node, identity: Identity) -> None:
    rviz = replace(identity, wildcard=True)
    for name, code in (("/viewer_17", 1), ("/viewer", 1), ("/robot", -1), ("/master", -1)):
        answer = await call(node, rviz, "requestTopic", name, "/t", [["TCPROS"]])
        assert isinstance(answer, list)
        assert answer[0] == code
    answer = await call(node, identity, "requestTopic", "/viewer_17", "/t", [["TCPROS"]])
    assert answer == [-1, "rossec: caller_id is not /viewer", []]


async def test_a_peer_that_asks_for_an_alias_is_refused(node: Node, identity: Identity) -> None:
    for topic in ("/remote/hospital/robot/pose", "/remote"):
        answer = await call(node, identity, "requestTopic", "/viewer", topic, [["TCPROS"]])
        assert answer == [-1, f"rossec: {ALIAS_ASKED}", []]


async def test_a_foreign_tool_gets_no_names_of_other_domains(node: Node, identity: Identity) -> None:
    foreigner = replace(identity, name="/remote/hospital/viewer", certified="/viewer")
    rows = [["/t", "p/T"], ["/remote/clinic/t", "p/T"]]
    node.describe = lambda: {"getSubscriptions": rows}  # type: ignore[method-assign]
    api = SlaveApi(node)
    assert await api("getSubscriptions", ("/viewer",), foreigner, authorized=True) == [1, "", [["/t", "p/T"]]]
    assert await api("getSubscriptions", ("/viewer",), identity, authorized=True) == [1, "", rows]
