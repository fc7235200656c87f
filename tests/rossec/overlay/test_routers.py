import json

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from rossec.errors import ConfigurationError
from rossec.overlay.documents import Routers, check_account, check_locator, check_password, is_encrypted
from rossec.overlay.router_tls import RouterAuthority
from tests.support.pki import NOW

PASSWORD = "A" * 43
TCP = ("tcp/127.0.0.1:7447",)


@pytest.fixture(scope="module")
def root() -> str:
    key = ec.generate_private_key(ec.SECP256R1())
    return RouterAuthority.create(key, now=NOW, serial=7).pem.decode()


def test_an_account_file_is_read_as_it_was_written(root: str) -> None:
    locators = ("tls/router.example.org:443", "quic/[2001:db8::1]:7447", *TCP)
    made = Routers(locators, "home", PASSWORD, root)
    assert Routers.read(made.write()) == made
    everybody = Routers(TCP, "open")
    assert Routers.read(everybody.write()) == everybody


def test_a_password_is_shown_nowhere(root: str) -> None:
    made = Routers(("tls/a:1",), "home", PASSWORD, root)
    assert PASSWORD not in repr(made)
    with pytest.raises(ConfigurationError) as caught:
        check_password(PASSWORD + "!")
    assert PASSWORD not in f"{caught.value} {caught.value.hint}"


@pytest.mark.parametrize(
    "change",
    [
        {"locators": []},
        {"locators": ["tls/a:1"] * 17},
        {"locators": "tls/a:1"},
        {"locators": [1]},
        {"locators": ["tls/a"]},
        {"account": "Home"},
        {"account": 1},
        {"password": ""},
        {"password": "short"},
        {"password": None},
        {"root_certificate": ""},
        {"root_certificate": "-----BEGIN"},
        {"root_certificate": 0},
        {"more": 1},
        {"rossec-account": 2},
    ],
)
def test_an_account_file_with_anything_else_is_refused(root: str, change: dict[str, object]) -> None:
    made = json.loads(Routers(("tls/a:1",), "home", PASSWORD, root).write())
    with pytest.raises(ConfigurationError):
        Routers.read(json.dumps(made | change).encode())


def test_two_certificates_are_not_one(root: str) -> None:
    with pytest.raises(ConfigurationError, match="needs the certificate"):
        Routers(("tls/a:1",), "home", PASSWORD, root + root)


def test_an_account_file_of_many_bytes_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="at most"):
        Routers.read(b" " * 20000)


def test_what_a_locator_says() -> None:
    assert check_locator("tls/a.example.org:443") == ("tls", "a.example.org", 443)
    assert check_locator("quic/[::]:7447") == ("quic", "::", 7447)
    assert is_encrypted("tls/a:1")
    assert is_encrypted("quic/a:1")
    assert not is_encrypted("tcp/a:1")


@pytest.mark.parametrize(
    "locator",
    [
        "",
        "tls/a:0",
        "tls/a:65536",
        "tls/:1",
        "udp/a:1",
        "tls/a",
        "a:1",
        "tls/a:1?x=1",
        "tls/a:1 ",
        "tls/a:1#root_ca_certificate=/tmp/evil.pem",
        "TLS/a:1",
        "tls//a:1",
        "tls/a:1\n",
        "tls/ä:1",
        "unixsock-stream//tmp/a",
    ],
)
def test_a_locator_that_says_more_is_refused(locator: str) -> None:
    with pytest.raises(ConfigurationError, match="is not the address of a router"):
        check_locator(locator)


@pytest.mark.parametrize("account", ["", "A", "a" * 33, "a/b", "*", "**", "a-b", "@a", "a\n"])
def test_an_account_that_could_reach_further_is_no_name(account: str) -> None:
    with pytest.raises(ConfigurationError, match="is not the name of an account"):
        check_account(account)
