"""Hosts in URIs: valid ones, equal spellings, and loopback."""

import pytest

from rossec.master.state.registry import (
    endpoint,
    is_connectable,
    is_loopback_host,
    is_reachable_from_here,
    is_unicast_host,
)


@pytest.mark.parametrize(
    "host", ["robot", "robot.local", "x_y-1.example.org.", "10.0.0.7", "fe80::1", "a.b1", "1a"]
)
def test_unicast_hosts(host: str) -> None:
    assert is_unicast_host(host)
    assert not is_loopback_host(host)


@pytest.mark.parametrize(
    "host",
    [
        "",
        "0.0.0.0",
        "::",
        "::ffff:0.0.0.0",
        "224.0.0.1",
        "ff02::1",
        "255.255.255.255",
        "127.1",
        "2130706433",
        "0x7f000001",
        "0X7F.1",
        "017700000001",
        "127.0.0.01",
        "127.0.0.1.",
        "1.2.3.4.5",
        "256.1.1.1",
        "a.b.1",
        "0x",
        ":1",
    ],
)
def test_other_hosts_and_unusual_spellings_are_refused(host: str) -> None:
    assert not is_unicast_host(host)


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1",
        "127.9.9.9",
        "::1",
        "::ffff:127.0.0.1",
        "localhost",
        "a.localhost",
        "localhost.localdomain",
        "ip6-localhost",
        "localhost.",
    ],
)
def test_loopback_hosts(host: str) -> None:
    assert is_loopback_host(host)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("http://Robot:80/", "http://robot:080"),
        ("http://[::1]:80/", "http://[0:0::1]:80/x"),
        ("http://[::ffff:10.0.0.7]:80/", "http://10.0.0.7:80/"),
        ("http://robot.local.:80/", "http://robot.local:80/"),
    ],
)
def test_spellings_of_one_endpoint_are_equal(one: str, other: str) -> None:
    assert endpoint(one) == endpoint(other)
    assert endpoint(one) != endpoint(one.replace("80", "81"))


@pytest.mark.parametrize(
    ("host", "reachable"),
    [
        ("10.0.0.1", True),
        ("robot.local", True),
        ("fd00::1", True),
        ("127.0.0.1", False),
        ("localhost", False),
        ("::1", False),
        ("169.254.1.1", False),
        ("fe80::1", False),
        ("::ffff:127.0.0.1", False),
    ],
)
def test_loopback_and_link_local_mean_another_machine_here(host: str, *, reachable: bool) -> None:
    assert is_reachable_from_here(host) is reachable


@pytest.mark.parametrize(
    ("uri", "connectable"),
    [
        ("http://h:1/", True),
        ("rosrpc://h:1", False),
        ("http://h/", False),
        ("http://:1/", False),
        ("http://u@h:1/", False),
        ("http://h:99999/", False),
        ("http://h:1/ ", False),
        ("http://0.0.0.0:1/", False),
        ("http://h:1/" + "x" * 600, False),
    ],
)
def test_a_uri_names_a_host_and_a_port(uri: str, *, connectable: bool) -> None:
    assert is_connectable(uri, "http") is connectable
