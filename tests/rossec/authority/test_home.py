import shutil
from pathlib import Path
from typing import NoReturn

import pytest

from ca.errors import DomainsRefused, PassphraseRefused, RevocationRefused
from ca.names import is_reserved
from ca.revocation.state import open_list
from ca.revocation.tree import TreeEntries, open_tree
from ca.store.record import Store
from rossec.authority.home import ENTRIES, AuthorityHome, fingerprint
from rossec.authority.signing import OWN_NODE
from rossec.errors import ConfigurationError
from rossec.ros.names import MASTER
from tests.support.domains import domains, foreign
from tests.support.pki import Site

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
    [
        "ca.store.record.Store.create",
        "ca.keys.key_files.write_private",
        "rossec.files.commit_directory",
    ],
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


def test_the_entries_of_a_tree_are_in_the_record_or_beside_it(
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

    def older(*_: object) -> NoReturn:
        raise RevocationRefused("written by an older version")

    monkeypatch.setattr("rossec.authority.list_contents.tree_entries", older)
    with pytest.raises(ConfigurationError, match="the entries of the tree are missing"):
        copy.newest_statement()[1]
    (copy.path / ENTRIES).write_bytes(entries)
    (copy.path / ENTRIES).chmod(0o600)
    assert copy.newest_statement()[1] == entries
