from pathlib import Path

import pytest

from ca.errors import PassphraseRefused
from ca.names import RESERVED
from ca.revocation.state import RevocationList, open_list, open_statement
from ca.revocation.tree import TreeEntries, is_tree, open_tree
from grants import document
from grants.model import Draft, Permission, Right
from grants.renewal import open_delegation
from rossec.authority.home import AuthorityHome, fingerprint
from rossec.authority.signing import OWN_NODE
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.participant.slave_api import MASTER

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


def test_a_revocation_is_signed_and_numbered(home: AuthorityHome) -> None:
    unlocked = home.unlock(PASSPHRASE)
    listed = unlocked.revoke(b"g" * 16, "test", NOW)
    assert open_list(home.revocation_list(), home.anchor().public_key) == listed
    assert listed.entries == {b"g" * 16}
    assert unlocked.revoke(b"g" * 16, "again", NOW).seq == listed.seq + 1


def test_fingerprints_are_for_reading(home: AuthorityHome) -> None:
    text = fingerprint(home.anchor())
    assert text.replace(" ", "") == home.anchor().thumbprint.hex()[:32]
    assert len(text.split()) == 8


def test_the_list_is_kept_young_while_the_key_is_at_hand(home: AuthorityHome) -> None:
    unlocked = home.unlock(PASSPHRASE)
    seq = unlocked.sign_list(NOW).seq
    node = NodeHome.of(home.path.parent, "/robot")
    node.create_request("home")
    unlocked.issue(node.request(), NOW + 6 * 86400)
    assert unlocked.store.next_number() == (1, seq + 1)
    unlocked.issue(node.request(), NOW + 8 * 86400)
    assert unlocked.store.next_number() == (1, seq + 2)


def test_the_names_nobody_may_share_are_the_masters_and_its_own() -> None:
    assert {MASTER, OWN_NODE} == RESERVED


def test_a_list_that_was_not_signed_for_a_revocation_is_signed_next(home: AuthorityHome) -> None:
    unlocked = home.unlock(PASSPHRASE)
    unlocked.store.revoke(b"d" * 32, "then it was killed", NOW)
    with pytest.raises(ConfigurationError, match="no valid identity") as caught:
        unlocked.revoke_identity("/robot7", "again", NOW)
    assert "rossec ca publish" in caught.value.hint
    assert b"d" * 32 in open_list(home.revocation_list(), home.own_key()).entries


def test_a_revoked_grant_leaves_the_list_when_nothing_can_bring_it_back(
    tmp_path: Path,
) -> None:
    opened = AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW).unlock(PASSPHRASE)
    draft = Draft(
        "home", "/a", bytes(32), NOW, NOW + 10, NOW + 1000, bytes(16),
        (Permission("/t", Right.PUBLISH),),
    )  # fmt: skip
    entry = document.grant_id(opened.issue_grant(draft, NOW))
    opened.revoke(bytes(32), "", NOW)
    assert opened.revoke(entry, "", NOW).entries == {entry, bytes(32)}
    assert entry in opened.sign_list(NOW + 1000).entries
    assert opened.sign_list(NOW + 1061).entries == {bytes(32)}
    assert entry in opened.store.revoked_entries()


def test_what_is_delegated_is_recorded_until_it_is_withdrawn(tmp_path: Path) -> None:
    opened = AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW).unlock(PASSPHRASE)
    with pytest.raises(ConfigurationError, match="no delegation is in force"):
        opened.revoke_delegations("", NOW)
    living, expired = (
        open_delegation(
            opened.issue_delegation(bytes(32), days * 86400, 60, NOW), opened.signer.public_key
        )
        for days in (2, 1)
    )
    listed, count = opened.revoke_delegations("", NOW + 86400)
    assert (listed.entries, count) == (frozenset({living.id}), 1)
    assert expired.id not in listed.entries
    with pytest.raises(ConfigurationError):
        opened.revoke_delegations("", NOW + 86400)


def test_too_many_revocations_become_a_tree(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    home = AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW)
    with pytest.raises(ConfigurationError, match="are not a tree"):
        home.tree_entries()
    opened = home.unlock(PASSPHRASE)
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 1)
    assert not is_tree(opened_list(opened.revoke(bytes(32), "", NOW), home))
    listed = opened.revoke(bytes(16), "", NOW)
    tree = open_tree(opened_list(listed, home), home.anchor().public_key)
    assert (tree.number, tree.size) == (listed.number, 2)
    TreeEntries.read(home.tree_entries()).check(tree)


def opened_list(listed: RevocationList, home: AuthorityHome) -> bytes:
    """The statement that was signed with the number of `listed`."""
    data = home.revocation_list()
    assert open_statement(data, home.anchor().public_key).number == listed.number
    return data
