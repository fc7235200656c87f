import socket

import pytest

from rossec.errors import ConfigurationError
from rossec.inprocess.sockets import bracketed, for_family, parse_rosrpc


@pytest.mark.parametrize(
    ("uri", "result"),
    [
        ("http://::1:1234/", "http://[::1]:1234/"),
        ("rosrpc://fe80::2:80", "rosrpc://[fe80::2]:80"),
        ("http://[::1]:1234/", "http://[::1]:1234/"),
        ("http://127.0.0.1:1234/", "http://127.0.0.1:1234/"),
        ("rosrpc://robot:80", "rosrpc://robot:80"),
    ],
)
def test_only_literals_without_brackets_get_them(uri: str, result: str) -> None:
    assert bracketed(uri) == result


@pytest.mark.parametrize(
    ("uri", "address"),
    [
        ("rosrpc://robot:80", ("robot", 80)),
        ("rosrpc://robot:80/", ("robot", 80)),
        ("rosrpc://[::1]:80", ("::1", 80)),
        ("rosrpc://::1:80", ("::1", 80)),
    ],
)
def test_the_uri_of_a_service_is_parsed(uri: str, address: tuple[str, int]) -> None:
    assert parse_rosrpc(uri) == address


@pytest.mark.parametrize("uri", ["", "http://robot:80", "rosrpc://robot", "rosrpc://:80", "rosrpc://a:x"])
def test_an_invalid_uri_of_a_service_is_refused(uri: str) -> None:
    with pytest.raises(ConfigurationError, match="not the URI of a service") as caught:
        parse_rosrpc(uri)
    assert "rosrpc://host:port" in caught.value.hint


@pytest.mark.parametrize(
    ("family", "host", "dialled"),
    [
        (socket.AF_INET6, "127.0.0.1", "::ffff:127.0.0.1"),
        (socket.AF_INET6, "::1", "::1"),
        (socket.AF_INET6, "robot.local", "robot.local"),
        (socket.AF_INET, "127.0.0.1", "127.0.0.1"),
    ],
)
def test_a_socket_of_ipv6_reaches_addresses_of_ipv4(family: int, host: str, dialled: str) -> None:
    assert for_family(family, (host, 80)) == (dialled, 80)
