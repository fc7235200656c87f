from pathlib import Path

import pytest

from rossec.console.options import (
    ConsoleEndpoint,
    ConsoleOptions,
    Tls,
    check_name,
    check_origin,
    read_options,
)
from rossec.errors import ConfigurationError

CERTIFICATE, KEY, SOCKET = Path("/etc/tls.pem"), Path("/etc/tls.key"), Path("/run/c.sock")


def read(**options: object) -> ConsoleEndpoint:
    return read_options(ConsoleOptions(**options), "Hall")  # type: ignore[arg-type]


def test_without_options_it_is_for_this_host() -> None:
    found = read()
    assert (found.origin, found.name) == ("http://localhost:7411", "localhost")
    assert found.addresses == ("127.0.0.1", "::1")
    assert (found.port, found.tls, found.is_local, found.hsts) == (7411, Tls.NONE, True, False)


def test_on_the_network_it_has_the_name_that_mdns_announces() -> None:
    found = read(lan=True)
    assert (found.origin, found.name) == ("https://hall.local:7411", "hall.local")
    assert (found.tls, found.is_local, found.hsts) == (Tls.OWN, False, False)
    assert found.addresses == ("0.0.0.0", "::")


def test_the_domain_of_the_host_is_not_part_of_that_name() -> None:
    assert read_options(ConsoleOptions(lan=True), "hall.example.org").name == "hall.local"


def test_a_host_with_a_strange_name_is_asked_for_one() -> None:
    with pytest.raises(ConfigurationError, match="the name of this host") as caught:
        read_options(ConsoleOptions(lan=True), "my_robot")
    assert "--name" in caught.value.hint


def test_certificates_of_a_real_name() -> None:
    found = read(tls_certificate=CERTIFICATE, tls_key=KEY, name="CA.Example.org", port=443)
    assert (found.origin, found.tls, found.hsts) == ("https://ca.example.org", Tls.FILES, True)
    assert (found.tls_certificate, found.tls_key) == (CERTIFICATE, KEY)


def test_behind_a_proxy() -> None:
    found = read(unix_path=SOCKET, origin="https://ca.example.org/")
    assert (found.origin, found.name) == ("https://ca.example.org", "ca.example.org")
    assert found.proxy_user is None
    assert read(unix_path=SOCKET, origin="https://a.example", proxy_user="www").proxy_user == "www"
    assert (found.unix_path, found.addresses, found.is_local) == (SOCKET, (), True)


@pytest.mark.parametrize(
    ("given", "found"),
    [
        ("https://ca.example.org:443", "https://ca.example.org"),
        ("https://CA.example.org:8443", "https://ca.example.org:8443"),
        ("http://localhost:8080", "http://localhost:8080"),
    ],
)
def test_an_origin_is_written_as_browsers_write_it(given: str, found: str) -> None:
    assert read(unix_path=SOCKET, origin=given).origin == found


@pytest.mark.parametrize(
    "origin",
    [
        "",
        "ca.example.org",
        "https://",
        "https://ca.example.org/console",
        "https://a@b.example",
        "ftp://ca.example.org",
        "https://ca.example.org:x",
        "https://ca.example.org?x",
    ],
)
def test_what_is_no_origin_is_refused(origin: str) -> None:
    with pytest.raises(ConfigurationError, match=r"is not an? (origin|DNS name)"):
        read(unix_path=SOCKET, origin=origin)


def test_a_proxy_without_encryption_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="is not encrypted"):
        read(unix_path=SOCKET, origin="http://ca.example.org")


@pytest.mark.parametrize("name", ["192.168.1.5", "fd00::7", "[fd00::7]", "127.0.0.1"])
def test_an_address_is_refused_with_the_reason(name: str) -> None:
    with pytest.raises(ConfigurationError, match="a passkey cannot belong to one"):
        read(lan=True, name=name)


def test_an_origin_with_an_address_is_refused_with_the_reason() -> None:
    for origin in ("https://192.168.1.5", "https://[fd00::7]:8443"):
        with pytest.raises(ConfigurationError, match="a passkey cannot belong to one"):
            read(unix_path=SOCKET, origin=origin)


@pytest.mark.parametrize(
    "name",
    [
        "",
        "local",
        "a..b",
        ".local",
        "rossec.local.",
        "-a.local",
        "a-.local",
        "ros_sec.local",
        "a" * 64 + ".local",
        ".".join(["a" * 60] * 5),
        "rössec.local",
        "192.168.1",
        "a.b.1",
        "a b",
    ],
)
def test_what_is_no_name_is_refused(name: str) -> None:
    with pytest.raises(ConfigurationError, match="is not a DNS name"):
        check_name(name)


@pytest.mark.parametrize("name", ["rossec.local", "a", "4robots.local", "xn--rssec-kva.local"])
def test_a_name_is_taken_in_lower_case(name: str) -> None:
    assert check_name(name.upper()) == name


def test_no_other_device_reaches_localhost() -> None:
    with pytest.raises(ConfigurationError, match="no other device"):
        read(lan=True, name="localhost")


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"lan": True, "unix_path": SOCKET, "origin": "https://a.example"}, "exclude each other"),
        ({"lan": True, "tls_certificate": CERTIFICATE}, "exclude each other"),
        ({"tls_certificate": CERTIFICATE, "tls_key": KEY}, "needs its key and its name"),
        ({"tls_key": KEY, "name": "a.example"}, "needs its key and its name"),
        ({"unix_path": SOCKET}, "needs both"),
        ({"origin": "https://a.example"}, "needs both"),
        ({"name": "a.example"}, "--name is for"),
        ({"hand_out": True}, "--hand-out is for --lan"),
        ({"unix_path": SOCKET, "origin": "https://a.example", "port": 80}, "--port is not for"),
        ({"proxy_user": "www-data"}, "--proxy-user is for --unix"),
        ({"port": 0}, "is not a port"),
        ({"port": 65536}, "is not a port"),
    ],
)
def test_options_that_do_not_go_together(options: dict[str, object], reason: str) -> None:
    with pytest.raises(ConfigurationError, match=reason) as caught:
        read(**options)
    assert caught.value.hint


def test_passkeys_of_another_origin_stop_the_start() -> None:
    endpoint = read(lan=True)
    check_origin(endpoint, (), rename=False)
    check_origin(endpoint, {endpoint.origin, "http://localhost:7411"}, rename=False)
    check_origin(endpoint, {"http://localhost:7411"}, rename=True)
    with pytest.raises(ConfigurationError, match="cannot approve at https://hall") as caught:
        check_origin(endpoint, {"http://localhost:7411"}, rename=False)
    assert "--rename" in caught.value.hint


def test_what_is_only_for_looking_stays_so() -> None:
    assert [
        read(read_only=True).read_only,
        read(lan=True, read_only=True).read_only,
        read(unix_path=SOCKET, origin="https://a.example", read_only=True).read_only,
        read().read_only,
    ] == [True, True, True, False]
