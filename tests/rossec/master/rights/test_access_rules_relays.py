"""What the policy table says of relays: who is one, and that nobody registers their forwarded ports."""

from dataclasses import replace

import pytest

from rossec.master.rights.access_rules import AccessControl
from rossec.master.rights.caller import Refused
from rossec.master.state.graph import Graph
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry
from tests.rossec.master.fakes import caller, everything
from tests.rossec.master.rights.victim import EVIL_API, T


def empty_graph() -> Graph:
    registry = Registry()
    return Graph(registry, Imports(registry))


@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("registerPublisher", ("/t", T, "http://127.0.0.1:7001/")),
        ("registerSubscriber", ("/t", T, "http://127.0.0.1:7001/x")),
        ("registerService", ("/t", "rosrpc://127.0.0.1:7001", EVIL_API)),
        ("registerService", ("/t", "rosrpc://evil:2", "http://127.0.0.1:7001/")),
    ],
)
def test_no_node_registers_the_address_of_a_forwarded_port(method: str, params: tuple[str, ...]) -> None:
    graph = empty_graph()
    access = AccessControl(graph, "/master", lambda place: place == ("127.0.0.1", 7001))
    with pytest.raises(Refused, match="a relay of this site listens at this address"):
        access.check(method, everything("/x"), ("/x", *params))
    with pytest.raises(Refused, match="needs the right"):
        access.check(method, caller("/x"), ("/x", *params))
    AccessControl(graph, "/master").check(method, everything("/x"), ("/x", *params))


@pytest.mark.parametrize(
    ("name", "allowed"),
    [
        ("/relay", True),
        ("/relay/roof", True),
        ("/relay/a/b", False),
        ("/relayed", False),
        ("/master", False),
        ("/remote/hospital/relay", False),
    ],
)
def test_only_a_relay_of_the_own_domain_passes(name: str, *, allowed: bool) -> None:
    access = AccessControl(empty_graph(), "/master")
    who = everything(name)
    for method in ("rossec.relayForwardedPorts", "rossec.relayTarget"):
        for each, passes in (
            (who, allowed),
            (replace(who, wildcard=True), False),
            (replace(who, certified="/rel"), False),
        ):
            if passes:
                access.check(method, each, (name,))
                continue
            with pytest.raises(Refused, match="only relays of the own domain may call this"):
                access.check(method, each, (name,))
