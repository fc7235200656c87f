"""Arguments and environment of a ROS program, and the mistakes beginners make."""

import pytest

from rossec.errors import ConfigurationError
from rossec.ros.names import Settings, build_uri, is_loopback, parse_uri, read


def settings(*argv: str, **environ: str) -> Settings:
    return read(argv, environ, default_name="talker")


def test_defaults() -> None:
    found = settings()
    assert found.name == "/talker"
    assert (found.master_host, found.master_port) == ("localhost", 11311)
    assert found.address is None
    assert not found.ipv6
    assert found.arguments == ()


def test_everything_set() -> None:
    found = settings(
        *("in:=/out", "_rate:=5", "__name:=cam", "--verbose", "/x:=y"),
        ROS_NAMESPACE="robot1",
        ROS_MASTER_URI="http://[::1]:12000/",
        ROS_IP="10.0.0.2",
        ROS_IPV6="on",
    )
    assert found.name == "/robot1/cam"
    assert (found.master_host, found.master_port) == ("::1", 12000)
    assert found.address == "10.0.0.2"
    assert found.ipv6
    assert found.remappings == {"/robot1/in": "/out", "/x": "/robot1/y"}
    assert found.parameters == {"/robot1/cam/rate": "5"}
    assert found.arguments == ("--verbose",)
    assert found.resolve("in") == "/out"
    assert found.resolve("~in") == "/robot1/cam/in"


@pytest.mark.parametrize(
    ("argv", "expected"),
    [((), "host1"), (("__ip:=10.0.0.1",), "10.0.0.1"), (("__ip:=10.0.0.1", "__hostname:=host2"), "host2")],
)
def test_order_of_addresses(argv: tuple[str, ...], expected: str) -> None:
    assert settings(*argv, ROS_HOSTNAME="host1", ROS_IP="10.9.9.9").address == expected


def test_arguments_beat_the_environment() -> None:
    found = settings("__ns:=/a/b", "__master:=http://m:1", ROS_NAMESPACE="c", ROS_MASTER_URI="http://n:2")
    assert found.name == "/a/b/talker"
    assert found.master_uri == "http://m:1"


def test_a_name_with_a_namespace_brings_its_own() -> None:
    def name(*argv: str, of: str = "/site/robot") -> str:
        return read(argv, {"ROS_NAMESPACE": "c"}, default_name=of).name

    assert name() == "/site/robot"
    assert name("__ns:=/a") == "/a/robot"
    assert name("__name:=other") == "/site/other"
    assert name(of="/robot") == "/c/robot"
    for wrong in ("/robot/", "/", ""):
        with pytest.raises(ConfigurationError, match="the node name"):
            name(of=wrong)


@pytest.mark.parametrize(
    ("argv", "environ", "message", "hint"),
    [
        ((), {"ROS_MASTER_URI": "localhost:11311"}, "does not begin with http://", "http://"),
        ((), {"ROS_MASTER_URI": "https://h:1"}, "does not begin with http://", "http://"),
        ((), {"ROS_MASTER_URI": ""}, "does not begin with http://", "http://"),
        ((), {"ROS_MASTER_URI": "http://h"}, "has no port", ":11311"),
        ((), {"ROS_MASTER_URI": "http://:1"}, "names no host", "http://"),
        ((), {"ROS_MASTER_URI": "http://[::1"}, "names no host", "http://"),
        ((), {"ROS_MASTER_URI": "http://h:99999"}, "not a number", "http://"),
        ((), {"ROS_IP": ""}, "set but empty", "unset ROS_IP"),
        ((), {"ROS_IP": "robot"}, "not an IP address", "ROS_HOSTNAME"),
        ((), {"ROS_IP": "http://10.0.0.1"}, "an URI", "bare address"),
        ((), {"ROS_HOSTNAME": "robot:11311"}, "with a port", "address alone"),
        ((), {"ROS_IPV6": "1"}, "ROS_IPV6 is '1'", "on and off"),
        ((), {"ROS_NAMESPACE": "my-robot"}, "not a ROS name", "segments begin with a letter"),
        (("in:=",), {}, "lacks a side", "without spaces"),
        ((":=",), {}, "lacks a side", "without spaces"),
        (("__nam:=x",), {}, "not one of ROS's own", "__name"),
        (("__name:=a/b",), {}, "contains a namespace", "__ns:="),
        (("in:=a b",), {}, "not a ROS name", "segments begin with a letter"),
    ],
)
def test_refusals_have_hints(argv: tuple[str, ...], environ: dict[str, str], message: str, hint: str) -> None:
    with pytest.raises(ConfigurationError, match=message) as refused:
        settings(*argv, **environ)
    assert hint in refused.value.hint


def test_parse_uri_names_what_it_read() -> None:
    with pytest.raises(ConfigurationError, match="node uri"):
        parse_uri("x", "node uri")


@pytest.mark.parametrize(
    ("address", "alone"),
    [
        ("127.0.0.1", True),
        ("127.1.2.3", True),
        ("::1", True),
        ("localhost", True),
        ("192.168.1.5", False),
        ("robot.local", False),
        ("::", False),
        ("0.0.0.0", False),
        ("127.evil.example", False),
        ("127.0.0.1.evil.example", False),
        ("LOCALHOST", True),
        ("", False),
    ],
)
def test_what_only_this_host_can_reach(address: str, alone: bool) -> None:
    assert is_loopback(address) is alone


def test_the_uri_of_a_service() -> None:
    assert parse_uri("rosrpc://[::1]:4000", scheme="rosrpc") == ("::1", 4000)
    with pytest.raises(ConfigurationError, match="does not begin with rosrpc://") as refused:
        parse_uri("http://localhost:1", scheme="rosrpc")
    assert "rosrpc://localhost" in refused.value.hint


@pytest.mark.parametrize("host", ["robot.local", "10.0.0.1", "fd99::1"])
@pytest.mark.parametrize("scheme", ["http", "rosrpc"])
def test_what_is_built_can_be_taken_apart(host: str, scheme: str) -> None:
    assert parse_uri(build_uri(host, 4000, scheme=scheme), scheme=scheme) == (host, 4000)
