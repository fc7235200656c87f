import json

import pytest

from rossec.errors import ConfigurationError
from rossec.overlay.router_settings import MAX_ACCOUNTS, ROUTER_USER, Accounts, open_access_control

ROUTER = "r" * 43
HOME = "h" * 43
CLINIC = "c" * 43


@pytest.fixture
def accounts() -> Accounts:
    return Accounts(ROUTER).add("home", HOME).add("clinic", CLINIC)


def test_accounts_are_read_as_they_were_written(accounts: Accounts) -> None:
    assert Accounts.read(accounts.write()) == accounts
    assert accounts.names == ("clinic", "home")
    assert accounts.password("home") == HOME


def test_accounts_come_and_go(accounts: Accounts) -> None:
    assert accounts.remove("clinic").names == ("home",)
    assert accounts.names == ("clinic", "home")
    with pytest.raises(ConfigurationError, match="there is an account home already") as caught:
        accounts.add("home", HOME)
    assert "rossec router accounts show home" in caught.value.hint
    with pytest.raises(ConfigurationError, match="there is no account 'hall'") as caught:
        accounts.remove("hall")
    assert caught.value.hint == "there are: clinic, home"


@pytest.mark.parametrize("name", ["open", "Home", ROUTER_USER, "a/b", "*", ""])
def test_what_cannot_be_an_account(accounts: Accounts, name: str) -> None:
    with pytest.raises(ConfigurationError):
        accounts.add(name, HOME)


def test_there_are_not_more_accounts_than_a_router_bears() -> None:
    full = Accounts(ROUTER, {f"account{number}": HOME for number in range(MAX_ACCOUNTS)})
    assert Accounts.read(full.write()) == full
    with pytest.raises(ConfigurationError, match="at most 512 accounts"):
        full.add("one", HOME)


def test_no_password_is_shown(accounts: Accounts) -> None:
    assert not {word for word in (ROUTER, HOME, CLINIC) if word in repr(accounts)}


@pytest.mark.parametrize(
    "change",
    [
        {"router": 1},
        {"router": "short"},
        {"accounts": []},
        {"accounts": {"home": 1}},
        {"accounts": {"home": "short"}},
        {"accounts": {"open": HOME}},
        {"accounts": {"home:x\nevil": HOME}},
        {"more": 1},
    ],
)
def test_a_file_with_anything_else_is_refused(accounts: Accounts, change: dict[str, object]) -> None:
    with pytest.raises(ConfigurationError):
        Accounts.read(json.dumps(json.loads(accounts.write()) | change).encode())


def test_the_users_of_zenoh(accounts: Accounts) -> None:
    assert accounts.dictionary().decode().splitlines() == [
        f"_router:{ROUTER}",
        f"clinic:{CLINIC}",
        f"home:{HOME}",
    ]


def test_an_account_sends_to_all_and_reads_its_own(accounts: Accounts) -> None:
    control = accounts.access_control()
    assert control["default_permission"] == "deny"
    (subject,) = (each for each in control["subjects"] if each.get("usernames") == ["home"])
    (policy,) = (each for each in control["policies"] if each["subjects"] == [subject["id"]])
    rules = [each for each in control["rules"] if each["id"] in policy["rules"]]
    assert [(each["flows"], each["messages"], each["key_exprs"]) for each in rules] == [
        (["ingress"], ["put"], ["rossec/1/*/*"]),
        (["ingress"], ["declare_subscriber"], ["rossec/1/home/*"]),
        (["egress"], ["put"], ["rossec/1/home/*"]),
    ]


def test_routers_are_known_by_their_user_or_by_their_certificate(accounts: Accounts) -> None:
    control = accounts.access_control()
    forwarding = [policy["subjects"][0] for policy in control["policies"] if "forward" in policy["rules"]]
    subjects = {each["id"]: each for each in control["subjects"]}
    assert [{**subjects[each], "id": ""} for each in forwarding] == [
        {"id": "", "usernames": [ROUTER_USER]},
        {"id": "", "cert_common_names": ["rossec router"]},
    ]


def test_at_an_open_router_there_is_one_account() -> None:
    control = open_access_control()
    assert control["default_permission"] == "deny"
    assert {key for each in control["rules"] for key in each["key_exprs"]} == {"rossec/1/open/*"}
