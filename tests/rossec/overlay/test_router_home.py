import stat
from pathlib import Path

import pytest
from cryptography import x509

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.overlay.homes import RouterHome, new_password
from tests.support.routerprocess import PASSWORD, home_with


@pytest.fixture
def home(tmp_path: Path) -> RouterHome:
    return home_with(tmp_path / "router", "home", "clinic")


def _mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_first_start_makes_what_is_needed_once(tmp_path: Path) -> None:
    made = RouterHome(tmp_path / "router")
    made.prepare()
    before = made.authority().pem, made.accounts()
    made.prepare()
    assert (made.authority().pem, made.accounts()) == before
    assert made.accounts().names == ()
    assert made.settings().listen == ("tls/[::]:7447",)


def test_what_is_secret_is_the_owners_alone(home: RouterHome) -> None:
    home.write_for_zenoh(home.settings(), home.accounts())
    readable = {each.name for each in home.path.iterdir() if _mode(each) & 0o077}
    assert readable == {"authority.pem", "router.pem"}
    assert _mode(home.path) == 0o700


def test_secrets_that_others_can_read_are_not_used(home: RouterHome) -> None:
    for name, read in (("accounts.json", home.accounts), ("authority.key", home.authority)):
        (home.path / name).chmod(0o640)
        with pytest.raises(HintedError):
            read()


def test_without_a_first_start_there_is_nothing(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError, match=r"there is no .*accounts\.json") as caught:
        RouterHome(tmp_path / "router").accounts()
    assert "rossec router accounts add" in caught.value.hint


def test_what_was_told_is_kept_until_it_is_told_otherwise(tmp_path: Path) -> None:
    home = RouterHome(tmp_path / "router")
    home.prepare()
    home.tell(listen=("tls/[::]:443",), hosts=("a.example.org",), join=())
    home.tell(listen=(), hosts=(), join=("tls/b.example.org:443",))
    found = home.settings()
    assert found.locators == ("tls/a.example.org:443", "tls/b.example.org:443")
    with pytest.raises(ConfigurationError):
        home.tell(listen=("nowhere",))
    assert home.settings() == found


def test_an_account_file_has_what_a_relay_needs(home: RouterHome) -> None:
    found = home.account_file("home")
    assert found.locators == home.settings().listen
    assert (found.account, found.password) == ("home", PASSWORD + "home")
    assert found.root_certificate.encode() == home.authority().pem
    with pytest.raises(ConfigurationError, match="there is no account"):
        home.account_file("hall")


def test_the_account_of_everybody_has_no_password(tmp_path: Path) -> None:
    plain = home_with(tmp_path / "router", protocol="tcp").account_file("open")
    assert (plain.account, plain.password, plain.root_certificate) == ("open", "", "")


def test_a_change_that_fails_changes_nothing(home: RouterHome) -> None:
    before = home.accounts_version()
    with pytest.raises(ConfigurationError):
        home.change_accounts(lambda found: found.add("home", PASSWORD))
    assert home.accounts_version() == before
    home.change_accounts(lambda found: found.remove("home"))
    assert home.accounts_version() != before


def test_a_certificate_is_made_anew_only_when_it_must(home: RouterHome) -> None:
    def written() -> bytes:
        home.write_for_zenoh(home.settings(), home.accounts())
        return home.files.certificate.read_bytes()

    first = written()
    assert written() == first
    home.tell(hosts=("a.example.org",))
    second = written()
    names = x509.load_pem_x509_certificate(second).extensions.get_extension_for_class(
        x509.SubjectAlternativeName
    )
    assert "a.example.org" in names.value.get_values_for_type(x509.DNSName)
    home.files.certificate.write_bytes(first)  # as a crash between the two files leaves them
    assert written() not in {first, second}


def test_one_router_runs_from_a_directory(home: RouterHome) -> None:
    again = pytest.raises(ConfigurationError, match="another router runs")
    with home.alone(), again, home.alone():
        pass


def test_a_second_router_takes_over_what_the_first_shares(home: RouterHome, tmp_path: Path) -> None:
    second = RouterHome(tmp_path / "second")
    second.take(home.share())
    assert second.authority().pem == home.authority().pem
    assert second.accounts() == home.accounts()
    assert second.settings().join == home.settings().locators
    home.change_accounts(lambda found: found.remove("clinic"))
    second.take(home.share())
    assert second.accounts().names == ("home",)


def test_a_router_does_not_join_itself(home: RouterHome, tmp_path: Path) -> None:
    second = RouterHome(tmp_path / "second")
    second.take(home.share())
    second.tell(listen=("tls/127.0.0.1:9",))
    home.tell(join=("tls/127.0.0.1:9",))
    second.take(home.share())
    assert second.settings().join == home.settings().listen


def test_what_another_operator_shares_is_not_taken(home: RouterHome, tmp_path: Path) -> None:
    other = home_with(tmp_path / "other", "home")
    before = home.accounts()
    with pytest.raises(ConfigurationError, match="of another authority") as caught:
        home.take(other.share())
    assert "--home" in caught.value.hint
    assert home.accounts() == before


def test_passwords_are_long_and_never_the_same() -> None:
    made = {new_password() for _ in range(100)}
    assert {len(each) for each in made} == {43}
    assert len(made) == 100
