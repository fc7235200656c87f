"""What a relay may say in its calls."""

import math

import pytest

from rossec.master.api import arguments as arg
from rossec.master.api.arguments import ArgumentRefused, Check
from rossec.master.state.forwarded_ports import AT_ONCE, MAX_PEERS, ForwardedPort, PeerWay, Target

WAY = {"state": "up", "rtt_ms": 12.5, "retransmissions": 3, "router": "tls/r:7447", "streams": 2}
FORWARDED_PORT = ["office", "node", "/robot", "127.0.0.1", 7001]


def is_refused(check: Check, value: object) -> bool:
    try:
        check(value, "/relay")
    except ArgumentRefused as refused:
        return str(refused).startswith("ERROR: parameter [it]")
    return False


@pytest.mark.parametrize("kind", ["master", "node", "service"])
def test_a_kind_of_target(kind: str) -> None:
    assert arg.kind("it")(kind, "/relay") == kind


@pytest.mark.parametrize("kind", ["", "topic", 1, ["node"]])
def test_no_kind_of_target(kind: object) -> None:
    assert is_refused(arg.kind("it"), kind)


def test_a_name_is_absolute() -> None:
    assert arg.name("it")("/robot/arm", "/relay") == "/robot/arm"
    for wrong in ("robot", "", "/a b", "/", 7, None):
        assert is_refused(arg.name("it"), wrong)


def test_forwarded_ports_by_target() -> None:
    found = arg.forwarded_ports("it")(
        [FORWARDED_PORT, ["office", "service", "/clock", "fd00::1", 9]], "/relay"
    )
    assert found == {
        Target("office", "node", "/robot"): ForwardedPort("127.0.0.1", 7001),
        Target("office", "service", "/clock"): ForwardedPort("fd00::1", 9),
    }


@pytest.mark.parametrize(
    "wrong",
    [
        ["office", "node", "/robot", "127.0.0.1"],
        ["of fice", "node", "/robot", "127.0.0.1", 7001],
        ["office", "topic", "/robot", "127.0.0.1", 7001],
        ["office", "node", "robot", "127.0.0.1", 7001],
        ["office", "node", "/robot", "0.0.0.0", 7001],
        ["office", "node", "/robot", "127.1", 7001],
        ["office", "node", "/robot", "a@b", 7001],
        ["office", "node", "/robot", "127.0.0.1/x", 7001],
        ["office", "node", "/robot", "127.0.0.1", 0],
        ["office", "node", "/robot", "127.0.0.1", 65536],
        ["office", "node", "/robot", "127.0.0.1", -1],
        ["office", "node", "/robot", "127.0.0.1", True],
        "forwarded_port",
    ],
    ids=str,
)
def test_a_forwarded_port_that_is_not_one(wrong: object) -> None:
    assert is_refused(arg.forwarded_ports("it"), [FORWARDED_PORT, wrong])


def test_forwarded_ports_are_bounded() -> None:
    assert not is_refused(arg.forwarded_ports("it"), [FORWARDED_PORT] * AT_ONCE)
    assert is_refused(arg.forwarded_ports("it"), [FORWARDED_PORT] * (AT_ONCE + 1))
    assert is_refused(arg.forwarded_ports("it"), {})


def test_ways_by_peer() -> None:
    assert arg.ways("it")({"office": WAY}, "/relay") == {"office": PeerWay(**WAY)}  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "change",
    [
        {"state": 1},
        {"router": "r" * 256},
        {"rtt_ms": -1},
        {"rtt_ms": math.inf},
        {"more": 1},
        {"rtt_ms": math.nan},
        {"streams": "2"},
        {"retransmissions": True},
    ],
    ids=str,
)
def test_a_way_that_is_not_one(change: dict[str, object]) -> None:
    assert is_refused(arg.ways("it"), {"office": {**WAY, **change}})


def test_ways_are_bounded_and_closed() -> None:
    assert is_refused(arg.ways("it"), {"office": {"state": "up"}})
    assert is_refused(arg.ways("it"), {"of fice": WAY})
    assert is_refused(arg.ways("it"), [WAY])
    assert is_refused(arg.ways("it"), {f"p{number}": WAY for number in range(MAX_PEERS + 1)})
