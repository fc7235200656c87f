import json
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.overlay.router_settings import (
    Accounts,
    RouterFiles,
    RouterSettings,
    is_wildcard,
    nested,
    zenoh_settings,
)

FILES = RouterFiles(Path("/r/users"), Path("/r/a.pem"), Path("/r/key"), Path("/r/cert"))
ACCOUNTS = Accounts("r" * 43).add("home", "h" * 43)
JOIN = ("tls/b.example.org:7447",)


def test_settings_are_read_as_they_were_written() -> None:
    made = RouterSettings(("a.example.org",), ("tls/[::]:443", "tcp/127.0.0.1:7447"), JOIN)
    assert RouterSettings.read(made.write()) == made
    assert RouterSettings().listen == ("tls/[::]:7447",)


@pytest.mark.parametrize(
    "change",
    [
        {"listen": []},
        {"listen": ["tls/a:1"] * 17},
        {"listen": ["a:1"]},
        {"listen": "tls/a:1"},
        {"join": ["tls/[::]:1"]},
        {"join": ["tls/0.0.0.0:1"]},
        {"join": ["tls/a:1?x"]},
        {"join": [1]},
        {"hosts": ["a:b.example.org"]},
        {"hosts": ["a/b"]},
        {"hosts": ["a"] * 17},
        {"hosts": [""]},
        {"more": []},
    ],
)
def test_a_file_with_anything_else_is_refused(change: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        RouterSettings.read(json.dumps(json.loads(RouterSettings().write()) | change).encode())


def test_where_relays_find_a_router() -> None:
    hosts = ("a.example.org", "2001:db8::1")
    made = RouterSettings(hosts, ("tls/[::]:443", "quic/192.0.2.1:7447"), JOIN)
    assert made.own_locators == ("tls/a.example.org:443", "tls/[2001:db8::1]:443", "quic/192.0.2.1:7447")
    assert made.locators == (*made.own_locators, *JOIN)


def test_without_a_host_nobody_knows_where_it_is() -> None:
    with pytest.raises(ConfigurationError, match="by which name relays reach") as caught:
        RouterSettings(join=JOIN).locators  # noqa: B018
    assert "--host" in caught.value.hint


def test_what_the_certificate_is_for() -> None:
    made = RouterSettings(("a.example.org", "localhost"), ("tls/[::]:443", "quic/192.0.2.1:7447"))
    assert made.certified == ("a.example.org", "localhost", "192.0.2.1", "127.0.0.1", "::1")


def test_a_router_is_found_by_nobody_and_answers_no_questions() -> None:
    found = zenoh_settings(RouterSettings(), ACCOUNTS, FILES)
    assert found["mode"] == "router"
    for off in ("adminspace", "scouting/multicast", "scouting/gossip", "transport/shared_memory"):
        assert found[f"{off}/enabled"] is False


def test_a_router_with_accounts_knows_them_by_password() -> None:
    found = zenoh_settings(RouterSettings(join=JOIN), ACCOUNTS, FILES)
    assert found["access_control"] == ACCOUNTS.access_control()
    assert found["transport/auth/usrpwd/user"] == "_router"
    assert found["transport/auth/usrpwd/dictionary_file"] == "/r/users"
    assert found["transport/link/tls/verify_name_on_connect"] is True
    assert found["connect/endpoints"] == list(JOIN)


def test_customers_are_in_no_region_of_the_routers() -> None:
    found = zenoh_settings(RouterSettings(), ACCOUNTS, FILES)
    clients, others = ({"modes": ["client", "peer"]}, {"region_names": [ACCOUNTS.region], "negated": True})
    assert found["region_name"] == ACCOUNTS.region == ACCOUNTS.add("clinic", "c" * 43).region
    assert found["gateway"] == {"south": [{"filters": [clients]}, {"filters": [others]}]}
    assert Accounts("s" * 43).region != ACCOUNTS.region
    assert ACCOUNTS.router not in str(found["gateway"])


def test_an_open_router_asks_for_no_password_and_still_allows_inboxes_alone() -> None:
    found = zenoh_settings(RouterSettings(listen=("tcp/[::]:7447",)), None, FILES)
    assert not [path for path in found if "usrpwd" in path or "tls" in path]
    control = found["access_control"]
    assert isinstance(control, dict)
    assert (control["enabled"], control["default_permission"]) == (True, "deny")


def test_a_router_with_accounts_joins_none_that_it_cannot_verify() -> None:
    plain = RouterSettings(join=("tcp/192.0.2.1:7447",))
    with pytest.raises(ConfigurationError, match=r"does not join tcp/192\.0\.2\.1:7447") as caught:
        zenoh_settings(plain, ACCOUNTS, FILES)
    assert "tls/" in caught.value.hint
    assert zenoh_settings(plain, None, FILES)["connect/endpoints"] == ["tcp/192.0.2.1:7447"]


def test_settings_as_a_tree() -> None:
    assert nested({"a/b": 1, "a/c/d": [2], "e": None}) == {"a": {"b": 1, "c": {"d": [2]}}, "e": None}


def test_every_address() -> None:
    assert is_wildcard("::")
    assert is_wildcard("0.0.0.0")
    assert not is_wildcard("127.0.0.1")
    assert not is_wildcard("a.example.org")
