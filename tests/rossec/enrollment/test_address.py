import socket

import pytest

from rossec.errors import ConfigurationError
from rossec.host import addresses


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("192.168.1.7:40123", "192.168.1.7", 40123),
        ("192.168.1.7", "192.168.1.7", 11317),
        ("robot.local", "robot.local", 11317),
        ("[::1]:9", "::1", 9),
        ("[::1]", "::1", 11317),
        ("fd00::7", "fd00::7", 11317),
        ("[fe80::1%eth0.2]:9", "fe80::1%eth0.2", 9),
        ("robot_1.local.", "robot_1.local.", 11317),
    ],
)
def test_what_people_type(text: str, host: str, port: int) -> None:
    assert addresses.split(text) == (host, port)
    assert addresses.split(addresses.join(host, port)) == (host, port)


@pytest.mark.parametrize(
    "text",
    [
        "",
        ":9",
        "robot:",
        "robot:0",
        "robot:65536",
        "robot:9999999999",
        "robot:x",
        "robot:\u0661",
        "[::1]9x",
        "[]:9",
        "robot:-1",
        "a..b",
        "a\x00b",
        "-x",
        "a b",
        "../x",
        "a" * 64,
        "[::1%\x1b]:1",
    ],
)
def test_invalid_addresses_are_refused(text: str) -> None:
    with pytest.raises(ConfigurationError, match="is not an address of a node") as caught:
        addresses.split(text)
    assert "192.168.1.7:11317" in caught.value.hint


def test_this_host_has_addresses(monkeypatch: pytest.MonkeyPatch) -> None:
    for found in addresses.own_addresses():
        family = socket.AF_INET6 if ":" in found else socket.AF_INET
        assert socket.inet_pton(family, found)
    monkeypatch.setattr(addresses, "_towards", lambda family, where: "")
    assert addresses.own_addresses() == ["127.0.0.1", "::1"]
    monkeypatch.setattr(addresses, "_towards", lambda family, where: "192.168.1.7")
    assert addresses.own_addresses()[0] == "192.168.1.7"


def test_a_family_that_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise OSError("no such family")

    monkeypatch.setattr(socket, "socket", missing)
    assert addresses.own_addresses() == ["127.0.0.1", "::1"]
