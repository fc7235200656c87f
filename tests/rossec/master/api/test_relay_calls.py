"""The calls of relays, over a real state of trust and a registry."""

from typing import Any

import pytest

from grants.model import Right
from rossec.master.api.site_calls import is_idle
from rossec.master.state.forwarded_ports import ForwardedPort, ForwardedPorts, Target
from rossec.master.state.registry import NodeRef, Registry
from tests.rossec.master.fakes import call_api, master_api
from tests.rossec.master.rights.test_statements_foreign import Home
from tests.support.authority import EnrolledNode

WAY = {"state": "up", "rtt_ms": 12.0, "retransmissions": 3, "router": "tls/r:7447", "streams": 2}
ROBOT, CLOCK = Target("office", "node", "/robot"), Target("office", "service", "/clock")
TYPE = "std_msgs/String"


class Calls(Home):
    """A master with a node, a visitor of the hospital, and relays of both domains."""

    def __init__(self, **changes: Any) -> None:
        super().__init__(**changes)
        self.forwarded_ports, self.registry = ForwardedPorts(), Registry()
        self.api = master_api(
            self.registry,
            self.trust,
            name="/master",
            uri="http://m:11311/",
            pid=7,
            forwarded_ports=self.forwarded_ports,
        )
        self.relay = self.site.enroll("/relay")
        self.is_local = True
        own = NodeRef("/arm", "http://10.0.0.3:4711/", b"arm")
        self.registry.register_publisher("/pose", TYPE, own)
        self.registry.register_service("/grip", "rosrpc://10.0.0.3:4712", own)
        visitor = NodeRef("/remote/hospital/robot", "http://10.9.0.1:1/", b"visitor")
        self.registry.register_publisher("/pose", TYPE, visitor)
        self.registry.register_service("/theirs", "rosrpc://10.9.0.1:2", visitor)

    def ask(self, method: str, *params: object, by: EnrolledNode | None = None) -> Any:
        member = self.relay if by is None else by
        who = self.trust.caller(self.identity(member), self.now)
        found = call_api(self.api, method, (member.name, *params), who, self.now, is_local=self.is_local)
        return found.answer

    def poll(self, seen: int = 0, *forwarded_ports: list[object], **ways: Any) -> Any:
        return self.ask(
            "rossec.relayForwardedPorts", "one", seen, [*forwarded_ports], ways or {"office": WAY}
        )

    def target(self, kind: str, name: str, domain: str = "") -> Any:
        return self.ask("rossec.relayTarget", domain, kind, name)


@pytest.fixture
def calls() -> Calls:
    return Calls()


def test_a_relay_is_told_what_is_wanted_and_tells_where_it_is(calls: Calls) -> None:
    calls.forwarded_ports.want("office", [ROBOT, CLOCK])
    calls.forwarded_ports.masters = lambda: {"/master/kitchen": "http://k:11311/"}
    code, _, value = answer = calls.poll()
    assert (code, is_idle(answer)) == (1, False)
    assert value["wanted"] == [["office", "node", "/robot"], ["office", "service", "/clock"]]
    assert value["unwanted"] == []
    assert value["masters"] == {"/master/kitchen": "http://k:11311/"}
    again = calls.poll(value["version"], ["office", "node", "/robot", "127.0.0.1", 7001])
    assert is_idle(again)
    assert calls.forwarded_ports.forwarded_port(ROBOT) == ForwardedPort("127.0.0.1", 7001)
    found = calls.forwarded_ports.way("office")
    assert found is not None
    assert (found[0], found[1]._asdict()) == ("/relay", WAY)
    calls.forwarded_ports.want("office", [ROBOT])
    assert calls.poll(value["version"])[2]["unwanted"] == [["office", "service", "/clock"]]


def test_a_relay_of_another_host_has_no_forwarded_ports_on_loopback(calls: Calls) -> None:
    calls.is_local = False
    calls.forwarded_ports.want("office", [ROBOT])
    code, status, value = answer = calls.poll(0, ["office", "node", "/robot", "127.0.0.1", 7001])
    assert (code, value, is_idle(answer)) == (-1, {}, False)
    assert "rossec relay --bind ADDRESS" in status
    calls.poll(0, ["office", "node", "/robot", "10.0.0.9", 7001])
    assert calls.forwarded_ports.forwarded_port(ROBOT) == ForwardedPort("10.0.0.9", 7001)


@pytest.mark.parametrize("name", ["/relay", "/rounds/robot3", "/node", "/relay/a/b", "/master"])
def test_only_relays_of_the_own_domain_call(calls: Calls, name: str) -> None:
    site = calls.hospital.site if name in ("/relay", "/rounds/robot3") else calls.site
    if name == "/relay":
        calls = Calls(admitted=("/**", "/relay"))
        site = calls.hospital.site
        calls.trust.domains.take("hospital.example", *calls.hospital.word(), calls.now)
    member = site.enroll(name)
    for method, *params in (
        ("rossec.relayForwardedPorts", "one", 0, [], {}),
        ("rossec.relayTarget", "", "master", "/master"),
    ):
        code, status, _ = calls.ask(method, *params, by=member)
        assert (code, status) == (-1, "rossec: only relays of the own domain may call this")


def test_a_second_relay_may_call(calls: Calls) -> None:
    other = calls.site.enroll("/relay/roof")
    assert calls.ask("rossec.relayForwardedPorts", "x", 0, [], {}, by=other)[0] == 1
    assert calls.ask("rossec.relayTarget", "", "master", "/master", by=other)[0] == 1


def test_targets_of_the_own_domain_are_all_that_is_registered_here(calls: Calls) -> None:
    assert calls.target("master", "/master") == [1, "target", ["m", 11311]]
    assert calls.target("node", "/arm") == [1, "target", ["10.0.0.3", 4711]]
    assert calls.target("service", "/grip") == [1, "target", ["10.0.0.3", 4712]]


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        ("master", "/master/kitchen"),
        ("node", "/nobody"),
        ("service", "/none"),
        ("node", "/remote/hospital/robot"),
        ("service", "/theirs"),
        ("service", "/arm"),
        ("node", "/grip"),
    ],
)
def test_what_is_not_registered_here_by_an_own_node_is_refused(calls: Calls, kind: str, name: str) -> None:
    assert calls.target(kind, name) == [-1, f"rossec: no {kind} {name} is shown there", []]


def test_a_foreign_domain_without_export_rules_reaches_what_is_registered(calls: Calls) -> None:
    assert calls.target("node", "/arm", "hospital")[0] == 1
    assert calls.target("master", "/master", "hospital")[0] == 1


@pytest.mark.parametrize("exported", ["/pose", "/grip", "/arm"])
def test_a_foreign_domain_reaches_nodes_that_are_exported_to_it(exported: str) -> None:
    calls = Calls(exported=((exported, int(Right.SUBSCRIBE)),))
    assert calls.target("master", "/master", "hospital")[0] == 1
    assert calls.target("node", "/arm", "hospital")[0] == 1
    assert (calls.target("service", "/grip", "hospital")[0] == 1) is (exported == "/grip")


def test_what_is_not_exported_is_refused_as_what_is_unknown() -> None:
    calls = Calls(exported=(("/lamp", int(Right.SUBSCRIBE)),))
    for kind, known, unknown in (("node", "/arm", "/leg"), ("service", "/grip", "/grab")):
        refused = calls.target(kind, known, "hospital")
        assert refused[0] == -1
        other = calls.target(kind, unknown, "hospital")
        assert [refused[1].replace(known, "X"), refused[2]] == [other[1].replace(unknown, "X"), other[2]]


def test_a_domain_that_is_not_trusted_now_reaches_nothing(calls: Calls) -> None:
    assert calls.target("master", "/master", "clinic")[0] == -1
    assert calls.target("master", "/master", "hospital")[0] == 1
    listed = calls.trust.domains.anchors.listed("hospital")
    assert listed is not None
    calls.now = listed.entry.until
    refused = [-1, "rossec: no domain is called 'hospital' here", []]
    assert calls.target("master", "/master", "hospital") == refused


def test_an_address_on_loopback_is_for_a_relay_on_this_host(calls: Calls) -> None:
    here = NodeRef("/here", "http://127.0.0.1:5/", b"here")
    calls.registry.register_publisher("/h", TYPE, here)
    assert calls.target("node", "/here")[2] == ["127.0.0.1", 5]
    calls.is_local = False
    code, status, value = calls.target("node", "/here")
    assert (code, value) == (-1, [])
    assert "set ROS_IP" in status
    assert calls.target("node", "/arm")[0] == 1


def test_there_are_at_most_so_many_relays(calls: Calls) -> None:
    for number in range(64):
        other = calls.site.enroll(f"/relay/r{number}")
        assert calls.ask("rossec.relayForwardedPorts", "x", 0, [], {}, by=other)[0] == 1
    assert calls.poll()[1] == "rossec: this master has too many relays"


def test_the_older_one_of_two_relays_with_one_name_is_refused(calls: Calls) -> None:
    def poll(instance: str) -> Any:
        return calls.ask("rossec.relayForwardedPorts", instance, 0, [], {"office": WAY})

    assert [poll(each)[0] for each in ("one", "two", "two")] == [1, 1, 1]
    code, status, _ = poll("one")
    assert code == -1
    assert "another relay with this name" in status
    assert poll("two")[0] == 1
