import json

from rossec.overlay.documents import Routers
from tests.support.commands import Shell, refused

HOST = ("--host", "router.example.org")


def test_an_account_is_made_shown_listed_and_removed(empty: Shell) -> None:
    made = empty("router", "accounts", "add", "home", *HOST)
    assert made.code == 0
    account = Routers.read(made.out.encode())
    assert (account.account, account.locators) == ("home", ("tls/router.example.org:7447",))
    assert empty("router", "accounts", "show", "home").out == made.out
    assert empty("router", "accounts", "list").out == "home\n"
    assert json.loads(empty("router", "accounts", "list", "--json").out) == {"accounts": ["home"]}
    assert empty("router", "accounts", "remove", "home").out == "the account home is no more\n"
    assert "nobody has an account" in empty("router", "accounts", "list").err
    assert Routers.read(empty("router", "accounts", "add", "home").out.encode()) != account


def test_the_password_is_only_in_the_account_file(empty: Shell) -> None:
    password = Routers.read(empty("router", "accounts", "add", "home", *HOST).out.encode()).password
    for words in (("accounts", "list"), ("accounts", "add", "home"), ("accounts", "remove", "home")):
        said = empty("router", *words)
        assert password not in said.out + said.err


def test_the_account_of_everybody(empty: Shell) -> None:
    account = Routers.read(empty("router", "accounts", "show", "open", *HOST).out.encode())
    assert (account.account, account.password) == ("open", "")
    refused(empty("router", "accounts", "add", "open"), "open is the account at a router without accounts")


def test_what_cannot_be_done_with_accounts(empty: Shell) -> None:
    refused(empty("router", "accounts", "list"), "there is no", "rossec router accounts add")
    refused(empty("router", "accounts", "add", "home"), "by which name relays reach", "--host")
    assert empty("router", "accounts", "list").out == ""
    refused(empty("router", "accounts", "add", "Home", *HOST), "'Home' is not the name of an account")
    refused(empty("router", "accounts", "add", "home", "--host", "a b"), "is not the address")
    assert empty("router", "accounts", "add", "home", *HOST).code == 0
    refused(empty("router", "accounts", "add", "home"), "there is an account home already", "accounts show")
    refused(empty("router", "accounts", "show", "hall"), "there is no account 'hall'", "there are: home")
    refused(empty("router", "accounts", "remove", "hall"), "there is no account 'hall'")


def test_a_router_that_never_ran_is_told_where_it_will_listen(empty: Shell) -> None:
    words = "--listen", "tls/[::]:443", "--listen", "quic/[::]:443"
    said = empty("router", "accounts", "add", "home", *HOST, *words)
    locators = Routers.read(said.out.encode()).locators
    assert locators == ("tls/router.example.org:443", "quic/router.example.org:443")
    wrong = empty("router", *words, "accounts", "list")
    assert (wrong.code, "only --home stands before a verb" in wrong.err) == (2, True)


def test_another_directory(empty: Shell) -> None:
    home = str(empty.root / "second")
    assert empty("router", "--home", home, "accounts", "add", "clinic", *HOST).code == 0
    assert empty("router", "--home", home, "accounts", "list").out == "clinic\n"
    assert not (empty.root / "router").exists()
