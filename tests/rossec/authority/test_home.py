import shutil
from pathlib import Path

import pytest

from ca.certificates import to_pem
from ca.errors import DomainsRefused, PassphraseRefused, TokenRefused
from ca.keys.private_keys import KeyUri
from ca.names import is_reserved
from ca.revocation.lists import TreeEntries, open_list, open_tree
from ca.store.record import Store
from grants.renewal import open_delegation
from rossec.authority import home as token_modules
from rossec.authority.home import AuthorityHome, fingerprint
from rossec.authority.signing import OWN_NODE, delegations
from rossec.errors import ConfigurationError
from rossec.ros.names import MASTER
from tests.support.domains import domains, foreign
from tests.support.pki import Site
from tests.support.site import DAY
from tests.support.site import Site as RunningSite
from tests.support.token import PIN, softhsm

NOW = 1_800_000_000
PASSPHRASE = "four random words here"


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> AuthorityHome:
    return AuthorityHome.create(tmp_path_factory.mktemp("home") / "x", "home", PASSPHRASE, NOW)


def test_a_new_authority_has_a_node_and_an_empty_list(home: AuthorityHome) -> None:
    assert home.domain == "home"
    assert home.node().identity(NOW).name == OWN_NODE
    listed = open_list(home.revocation_list(), home.anchor().public_key)
    assert (listed.number, listed.entries) == ((1, 1), frozenset())


def test_a_second_one_in_the_same_place_is_refused(home: AuthorityHome) -> None:
    before = home.anchor()
    with pytest.raises(ConfigurationError, match="there is an authority in"):
        AuthorityHome.create(home.path.parent, "home", PASSPHRASE, NOW)
    assert home.anchor() == before


@pytest.mark.parametrize(
    "step",
    ["ca.store.record.Store.create", "ca.keys.private_keys.write_private", "rossec.files.commit_directory"],
)
def test_an_interrupted_beginning_never_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(step, interrupted)
        with pytest.raises(KeyboardInterrupt):
            AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW)
    assert list(tmp_path.iterdir()) == []
    (tmp_path / ".ca.0123").mkdir()  # of one that was killed
    AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW)
    assert AuthorityHome.at(tmp_path).unlock(PASSPHRASE).domain == "home"


def test_no_authority_names_the_next_command(tmp_path: Path) -> None:
    with pytest.raises(ConfigurationError) as caught:
        AuthorityHome.at(tmp_path)
    assert caught.value.hint == "next: rossec ca init DOMAIN"


def test_the_passphrase_counts(home: AuthorityHome) -> None:
    assert AuthorityHome.at(home.path.parent).unlock(PASSPHRASE).domain == "home"
    with pytest.raises(PassphraseRefused):
        home.unlock(PASSPHRASE + ".")


def test_fingerprints_are_for_reading(home: AuthorityHome) -> None:
    text = fingerprint(home.anchor())
    assert text.replace(" ", "") == home.anchor().thumbprint.hex()[:32]
    assert len(text.split()) == 8


def test_the_names_nobody_may_share_are_the_masters_and_its_own() -> None:
    assert is_reserved(MASTER)
    assert is_reserved(OWN_NODE)


def test_what_is_recorded_and_not_listed_is_counted(home: AuthorityHome) -> None:
    assert not home.is_intermediate
    opened = home.unlock(PASSPHRASE)
    opened.store.revoke(b"u" * 32, "then it was killed", NOW)
    assert home.count_unlisted(NOW) == 1
    opened.refresh_list(NOW)
    assert home.count_unlisted(NOW) == 0


def test_the_newest_list_of_domains_is_read_and_verified(home: AuthorityHome) -> None:
    assert home.domain_list() is None
    opened = home.unlock(PASSPHRASE)
    opened.store.domains.accept(foreign(Site.create("hospital.example")), NOW)
    listed = opened.sign_domains(NOW)
    found = home.domain_list()
    assert found is not None
    assert found[1] == listed
    opened.store.domains.save_list((2, 1), domains(Site.create("home"), seq=2), NOW)
    with pytest.raises(DomainsRefused):
        home.domain_list()


def test_before_a_list_is_signed_there_is_none(home: AuthorityHome, tmp_path: Path) -> None:
    shutil.copytree(home.path, tmp_path / "ca")
    (tmp_path / "ca" / "ca.db").unlink()
    Store.create(tmp_path / "ca" / "ca.db").close()
    with pytest.raises(ConfigurationError, match="no revocation list was signed yet") as caught:
        AuthorityHome.at(tmp_path).revocation_list()
    assert caught.value.hint == "next: rossec ca refresh"


def test_the_entries_of_a_tree_are_in_the_record(
    home: AuthorityHome, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.copytree(home.path, tmp_path / "ca")
    copy = AuthorityHome.at(tmp_path)
    assert copy.newest_statement() == (copy.revocation_list(), b"")
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    listed = copy.unlock(PASSPHRASE).revoke(bytes(16), "", NOW)
    tree = open_tree(copy.revocation_list(), copy.own_key())
    entries = copy.newest_statement()[1]
    TreeEntries.read(entries).check(tree)
    assert tree.number == listed.number


def test_grants_are_renewed_while_each_master_has_confirmed_to_have_the_leave(tmp_path: Path) -> None:
    """What was only signed, is another key's or is revoked renews nothing."""
    site = RunningSite(tmp_path, clock=lambda: NOW)
    (tmp_path / "ca.pem").write_bytes(to_pem(site.anchor.certificate))
    home = AuthorityHome(tmp_path)
    assert home.renewed_until(NOW) == 0
    given = site.delegate()
    assert home.renewed_until(NOW) == 0
    (delegation,) = delegations(home.path, home.own_key())
    assert open_delegation(given, home.own_key()) == delegation
    home.confirm_delegation(delegation.id, NOW)
    assert home.renewed_until(NOW) == delegation.expires
    assert home.renewed_until(delegation.expires) == 0
    longer = site.authority.issue_delegation(delegation.holder, 2 * DAY, 60, NOW)
    stranger = site.authority.issue_delegation(bytes(32), 2 * DAY, 60, NOW)
    for each in (longer, stranger):
        home.confirm_delegation(open_delegation(each, home.own_key()).id, NOW)
    until = open_delegation(longer, home.own_key())
    assert home.renewed_until(NOW) == until.expires
    site.authority.revoke(until.id, "", NOW)
    assert home.renewed_until(NOW) == delegation.expires
    site.authority.revoke(delegation.id, "", NOW)
    assert home.renewed_until(NOW) == 0


def test_a_key_in_a_token_is_opened_by_the_modules_that_were_named(tmp_path: Path) -> None:
    softhsm()
    uri = KeyUri.parse("pkcs11:token=spare;object=home-of-tests")
    home = AuthorityHome.create(tmp_path, "home", PIN, NOW, uri)
    assert home.key_uri() == uri
    assert home.unlock(PIN).domain == "home"
    assert home.load_key(PIN, [uri.module]).public_key == home.own_key()
    with pytest.raises(TokenRefused, match="is not trusted here"):
        home.load_key(PIN, [])
    (tmp_path / token_modules.FILE).unlink()
    with pytest.raises(TokenRefused, match="is not trusted here"):
        home.unlock(PIN)
