"""Each call in both forms: the same answer, the same denial, the same audit line.

Two masters are asked the same, one in XML-RPC, the other in the compact form: once without sockets,
with every call of the comparison with stock and with any values, and once over real connections.
"""

import logging
import re
from collections.abc import Iterator
from contextlib import AsyncExitStack
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from grants.model import Right
from rossec.errors import XmlRpcRefused
from rossec.master.api.methods import MasterEvent
from rossec.master.rights.access_rules import RULES
from rossec.master.rights.caller import Caller
from rossec.master.state.registry import Registry
from rossec.net.rpc.calls import RpcClient
from rossec.ros.calls import METHODS, CallClient, CallServer, value_in
from rossec.ros.names import SETTLE_RENEWALS, WATCH_RENEWALS
from rossec.ros.xmlrpc import Fault
from tests.rossec.master.fakes import FakeStatements, call_api, caller, everything, master_api
from tests.rossec.master.test_differential import TABLES, Call, wired
from tests.rossec.master.world import SlaveNode, World
from tests.rossec.ros.values import VALUES, shape

API, SERVICE = "http://h:1/", "rosrpc://h:11"
SAMPLES: dict[str, tuple[Any, ...]] = {
    "registerPublisher": ("/t", "std_msgs/String", API),
    "registerSubscriber": ("/t", "std_msgs/String", API),
    "registerService": ("/s", SERVICE, API),
    "unregisterPublisher": ("/t", API),
    "unregisterSubscriber": ("/t", API),
    "unregisterService": ("/s", SERVICE),
    "lookupService": ("/s",),
    "lookupNode": ("/other",),
    "getPublishedTopics": ("",),
    "shutdown": ("now",),
    "getParam": ("/p",),
    "hasParam": ("/p",),
    "subscribeParam": (API, "/p"),
    "unsubscribeParam": (API, "/p"),
    "searchParam": ("p",),
    "setParam": ("/p", {"a": [1, 2.0, True, b"x"]}),
    "deleteParam": ("/p",),
    "rossec.presentGrants": ([b"forged"],),
    "rossec.renewGrants": ([b"forged"],),
    "rossec.renewIdentity": (b"forged",),
    "rossec.updateDelegation": (b"forged",),
    "rossec.revocationsSince": (b"0",),
    "rossec.updateRevocations": (b"forged",),
    "rossec.updateRevocationTree": (b"forged", b"forged"),
    "rossec.revocationProofs": ([b"0"],),
    "rossec.domains": (b"0",),
    "rossec.updateDomains": (b"forged",),
    "rossec.foreignRevocations": ("hospital", b"0"),
    "rossec.foreignRevocationProofs": ("hospital", [b"0"]),
    "rossec.trl": (b"0",),
    "rossec.watchGraph": ("", 0),
    "rossec.followSite": ("", 0, ["/**"]),
    "rossec.relayForwardedPorts": ("", 0, [], {}),
    "rossec.relayTarget": ("hospital", "node", "/t"),
    "rossec.depositGrants": ([b"forged"],),
    "rossec.deliveryStates": ([b"0"],),
    "rossec.fetchGrants": (b"",),
    "rossec.watchGrants": (b"",),
}


class Side:
    """A master without sockets, asked in one form."""

    def __init__(self, *, compact: bool) -> None:
        self.api = master_api(
            Registry(), FakeStatements(), name="/master", uri="http://master:11311/", pid=7, instance="run"
        )
        self.client, self.server = CallClient("x", compact=compact), CallServer()
        self.events: list[MasterEvent] = []
        self.ask(("getPid", "/a"), everything("/a"))  # after it, units

    def ask(self, call: Call, who: Caller) -> Any:
        """What the caller gets: a value, a fault, or the word that nothing was sent."""
        try:
            request = self.server.take(self.client.request(call[0], call[1:]))
        except XmlRpcRefused as error:
            return "not sent", str(error)
        assert request is not None
        method, params = self.server.load(request)
        try:
            outcome = call_api(self.api, method, params, who, 0)
            self.events += outcome.events
            answer = self.server.respond(outcome.answer)
        except Fault as fault:
            answer = self.server.respond(fault)
        except AttributeError:  # the fake knows of no lists: those methods are called over sockets
            answer = self.server.respond(Fault(1, "unknown to the fake"))
        try:
            return shape(value_in(self.client.take(answer)))
        except Fault as fault:
            return fault.faultCode, fault.faultString


def pair() -> tuple[Side, Side]:
    return Side(compact=False), Side(compact=True)


def assert_same(calls: list[Call], who: Any) -> None:
    sides = pair()
    for call in calls:
        answers = [side.ask(call, who(call)) for side in sides]
        assert answers[0] == answers[1], call
        assert sides[0].events == sides[1].events, call
    assert sides[1].client.is_compact
    assert not sides[0].client.is_compact


def named(call: Call) -> str:
    return call[1] if len(call) > 1 and isinstance(call[1], str) else "/a"


@pytest.mark.parametrize("table", TABLES)
def test_every_call_of_the_comparison_with_stock(table: str) -> None:
    calls = [(call[0], *wired(list(call[1:]))) for call in TABLES[table]]
    assert_same(calls, lambda call: everything(named(call)))
    assert_same(calls, lambda _: caller("/a"))
    assert_same(calls, lambda _: caller("/a", {"/t": Right.PUBLISH, "/x": Right.PARAM_GET}))


ALL = [(method, "/a", *SAMPLES.get(method, ())) for method in RULES]


def test_every_method_of_the_table() -> None:
    assert SAMPLES.keys() <= RULES.keys()
    for who in (caller("/a"), everything("/a"), caller("/other"), everything("/ca")):
        assert_same(ALL, lambda _, who=who: who)
        assert_same([(*call, 1) for call in ALL], lambda _, who=who: who)  # arity
        assert_same([call[:2] for call in ALL], lambda _, who=who: who)
        assert_same([(call[0],) for call in ALL], lambda _, who=who: who)


def test_multicalls_and_unknown_methods() -> None:
    calls = [{"methodName": method, "params": list(params)} for method, *params in ALL if "." not in method]
    multicalls: list[Call] = [
        ("system.multicall", calls),
        ("system.multicall", [*calls, calls[0], {}, {"methodName": "nonsense", "params": []}]),
        ("system.multicall", [{"methodName": "getSystemState", "params": ["/a"]}] * 17),
        ("system.multicall",),
        ("system.multicall", []),
        ("nonsense", "/a"),
        ("rossec.later", "/a", 1),
    ]
    assert_same(multicalls, lambda _: everything("/a"))
    assert_same(multicalls, lambda _: caller("/a"))


def test_the_numbers_are_of_methods_that_there_are() -> None:
    """Those that came later are called by their name."""
    assert RULES.keys() - set(METHODS) == {WATCH_RENEWALS, SETTLE_RENEWALS}


@given(VALUES, st.sampled_from(["/p", "/a/b", "p"]))
@settings(deadline=None)
def test_a_parameter_is_the_same_in_whatever_forms_it_is_set_and_read(value: object, key: str) -> None:
    """Of several flaws in one tree, the order of its members decides which is named."""
    first, second = pair()
    who = everything("/a")
    answers = [side.ask(("setParam", "/a", key, value), who) for side in (first, second)]
    assert answers[0][0] == answers[1][0]
    assert answers[0][2] == answers[1][2]
    if answers[0][0] == ("int", 1):
        assert answers[0] == answers[1]
        read = [side.ask(("getParam", "/a", key), who) for side in (first, second)]
        assert read[0] == read[1]
        first.api, second.api = second.api, first.api  # set in one form, read in the other
        crossed = [side.ask(("getParam", "/a", key), who) for side in (first, second)]
        assert crossed == read


def test_a_carriage_return_is_kept_by_one_form_alone() -> None:
    """XML's own rule (1.0 section 2.11): the specification says so."""
    sides = pair()
    for side, expected in zip(sides, ("a\n", "a\r"), strict=True):
        side.ask(("setParam", "/a", "/p", "a\r"), everything("/a"))
        assert side.ask(("getParam", "/a", "/p"), everything("/a"))[2] == ("str", expected)


# -- over real connections


def comparable(value: object) -> object:
    """What two runs have in common: no ports, ids of runs, process ids or signed bytes."""
    match value:
        case list() | tuple():
            return [comparable(item) for item in value]
        case dict():
            return {name: comparable(below) for name, below in value.items() if name != "instance"}
        case bytes():
            return "bytes"
        case str():
            return re.sub(r"(?<=:)\d{2,5}(?=/)|(?<=grant )[0-9a-f]{8}", "...", value)
        case _:
            return value


async def result(client: RpcClient, method: str, *params: object) -> object:
    try:
        return comparable(await client.call(method, *params))
    except Fault as fault:
        return fault.faultCode, comparable(fault.faultString)


SLOW = {"rossec.watchGrants", "rossec.watchGraph", "rossec.followSite", "rossec.relayForwardedPorts"}


async def conversation(compact: bool, rights: dict[str, Right]) -> list[object]:
    """All calls of one node to a master of its own, in one form; `shutdown` comes last."""
    async with AsyncExitStack() as stack:
        world = World(stack)
        await world.start()
        node = await world.node("/a", rights)
        await world.node("/other")
        node.client = await client_of(world, node, compact=compact)
        methods = sorted(RULES.keys() - SLOW, key=lambda method: (method == "shutdown", method))
        found: list[object] = []
        for method in methods:
            params = [node.uri if item == API else item for item in SAMPLES.get(method, ())]
            answer = await result(node.client, method, "/a", *params)
            found.append((method, None if method == "getPid" else answer))
        assert node.client.is_compact == compact
        return found


async def client_of(world: World, node: SlaveNode, *, compact: bool) -> RpcClient:
    found = await world.call_as(node.member)
    return found if compact else RpcClient(found._stream, compact=False)


@pytest.fixture
def audited(caplog: pytest.LogCaptureFixture) -> Iterator[pytest.LogCaptureFixture]:
    with caplog.at_level(logging.INFO, "rossec"):
        yield caplog


def said(caplog: pytest.LogCaptureFixture) -> list[object]:
    """The lines of the audit and of the denials so far."""
    found: list[object] = [
        (record.name, record.levelname, comparable(record.getMessage()))
        for record in caplog.records
        if record.name.startswith("rossec.audit")
    ]
    caplog.clear()
    return found


@pytest.mark.parametrize(
    "rights",
    [{"/nothing": Right.PUBLISH}, {"/**": Right(255)}, {"/t": Right.PUBLISH, "/p": Right.PARAM_GET}],
    ids=["none", "all", "some"],
)
async def test_the_same_answers_and_audit_over_connections(
    rights: dict[str, Right], audited: pytest.LogCaptureFixture
) -> None:
    plain = await conversation(False, rights)
    plain_said = said(audited)
    compact = await conversation(True, rights)
    assert plain == compact
    assert plain_said == said(audited)
    assert plain_said
