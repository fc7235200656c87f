"""Whether the address that a node gives away leads to this host."""

import socket
from queue import SimpleQueue

import pytest

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.host.addresses import check_own_address, resolved, variable_of, warn_of_own_address

ELSEWHERE = "192.0.2.7"  # RFC 5737: no host's


def test_an_address_of_this_host() -> None:
    assert check_own_address("127.0.0.1", "ROS_IP") == "ROS_IP is 127.0.0.1, an address of this host"


def test_an_address_of_another_host() -> None:
    with pytest.raises(ConfigurationError, match="is no address of this host") as caught:
        check_own_address(ELSEWHERE, "ROS_IP")
    assert caught.value.hint.startswith("unset ROS_IP, or set ROS_IP to an address of this host")


@pytest.mark.parametrize("name", ["robot.invalid", "x" * 300, "a..b"])
def test_a_name_that_nobody_knows(name: str) -> None:
    assert resolved(name) == []
    with pytest.raises(ConfigurationError, match="a name that this host does not know"):
        check_own_address(name, "ROS_HOSTNAME")


def test_the_variable_is_named() -> None:
    assert variable_of({"ROS_IP": "x"}) == "ROS_IP"
    assert variable_of({"ROS_IP": "x", "ROS_HOSTNAME": "y"}) == "ROS_HOSTNAME"


def test_who_begins_with_it_is_warned() -> None:
    said: SimpleQueue[HintedError] = SimpleQueue()
    warn_of_own_address(None, {}, said.put)
    warn_of_own_address("127.0.0.1", {}, said.put)
    assert said.empty()
    warn_of_own_address(ELSEWHERE, {"ROS_IP": ELSEWHERE}, said.put)
    assert f"ROS_IP is {ELSEWHERE}, which is no address" in str(said.get_nowait())


def test_nobody_waits_for_a_resolver(monkeypatch: pytest.MonkeyPatch) -> None:
    slow: SimpleQueue[None] = SimpleQueue()

    def lookup(*_: object, **__: object) -> object:
        slow.get()
        raise socket.gaierror(-3, "Temporary failure in name resolution")

    monkeypatch.setattr(socket, "getaddrinfo", lookup)
    said: SimpleQueue[HintedError] = SimpleQueue()
    warn_of_own_address("robot.local", {"ROS_HOSTNAME": "robot.local"}, said.put)
    assert said.empty()  # it returned before the resolver did
    slow.put(None)
    assert "ROS_HOSTNAME is robot.local" in str(said.get(timeout=60))
