"""Addresses that lead nowhere: this host's own, and those of the nodes that it may reach."""

import socket
from collections.abc import Mapping
from pathlib import Path

import pytest

from rossec.cli.node.doctor import check_master, check_node_addresses, check_own_address
from rossec.cli.shared.context import Environment
from rossec.errors import ConfigurationError
from tests.support.attacker import call, credentials
from tests.support.site import Site

UNKNOWN = "robot.invalid"  # RFC 6761: never a name


def refusal(variables: Mapping[str, str]) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as refused:
        list(check_own_address(variables))
    return refused.value


def test_an_address_of_this_host_is_ok() -> None:
    assert list(check_own_address({})) == []
    assert list(check_own_address({"ROS_IP": "127.0.0.1"})) == [
        "ROS_IP is 127.0.0.1, an address of this host"
    ]
    assert list(check_own_address({"ROS_HOSTNAME": "localhost", "ROS_IP": "192.0.2.7"})) == [
        "ROS_HOSTNAME is localhost, an address of this host"
    ]


def test_an_address_of_another_host_is_said() -> None:
    error = refusal({"ROS_IP": "192.0.2.7"})
    assert "ROS_IP is 192.0.2.7, which is no address of this host" in str(error)
    assert error.hint.startswith("unset ROS_IP")


@pytest.mark.parametrize("name", [UNKNOWN, "x" * 300, "a..b"])
def test_a_name_that_nobody_knows_is_said(name: str) -> None:
    assert "a name that this host does not know" in str(refusal({"ROS_HOSTNAME": name}))


async def test_the_nodes_it_may_reach(tmp_path: Path) -> None:
    """The host name of a publisher is known where it runs, and not here."""
    async with Site(tmp_path / "site").running() as site:
        site.publish("/camera", "/image")
        home = site.enroll("/viewer")
        site.subscribe("/viewer", "/image")
        assert site.master is not None
        publisher = credentials(site, "/camera")
        grants = site.enroll("/camera").grants()
        await call(site.master.uri, publisher, "rossec.presentGrants", "/camera", grants)
        await call(
            site.master.uri,
            publisher,
            "registerPublisher",
            "/camera",
            "/image",
            "sensor_msgs/Image",
            f"http://{UNKNOWN}:4711/",
        )
        found = [each async for each in check_master(Environment(site.environ), home, ())]
        faults = [each for each in found if not isinstance(each, str)]
        assert [str(each) for each in faults] == [
            f"/camera is at {UNKNOWN}, a name that this host does not know"
        ]
        assert "set ROS_IP on its host" in faults[0].hint


@pytest.mark.parametrize("state", [None, [], [[], [], [["/s"]]], [1, 2, 3]])
async def test_odd_answers_name_no_node(tmp_path: Path, state: object) -> None:
    home = Site(tmp_path / "site").enroll("/viewer")

    async def answer(method: str, *_: object) -> object:
        return state if method == "getSystemState" else 0

    assert [each async for each in check_node_addresses(home, answer)] == []


def test_an_unknown_name_is_asked_of_the_resolver(monkeypatch: pytest.MonkeyPatch) -> None:
    def failing(*_: object, **__: object) -> object:
        raise socket.gaierror(-3, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", failing)
    assert "does not know" in str(refusal({"ROS_HOSTNAME": "localhost"}))
