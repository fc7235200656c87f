"""A list is behind when an entry is not in it, in whatever order the record says things."""

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from ca.errors import RecordUnusable, RevocationRefused
from ca.revocation.lists import RevocationList, open_tree, sign_list
from grants import document
from grants.model import Draft, Permission, Right
from rossec.authority import signing
from rossec.authority.home import AuthorityHome
from rossec.authority.signing import SigningAuthority
from rossec.errors import ConfigurationError

NOW = 1_800_000_000
PASSPHRASE = "four random words here"
KEY, OTHER = b"k" * 32, b"o" * 32


@pytest.fixture
def home(tmp_path: Path) -> AuthorityHome:
    return AuthorityHome.create(tmp_path, "home", PASSPHRASE, NOW)


@pytest.fixture
def opened(home: AuthorityHome) -> SigningAuthority:
    return home.unlock(PASSPHRASE)


def missing(opened: SigningAuthority, now: int = NOW) -> frozenset[bytes]:
    return signing.missing_entries(opened.store, opened.signer.public_key, now)


def lose(opened: SigningAuthority, entry: bytes) -> None:
    """A signer that was slower: what it revoked is recorded before a list that lacks it."""
    opened.store.revoke(entry, "lost", NOW)
    number = opened.store.next_number()
    data = sign_list(opened.signer, RevocationList(*number, NOW, NOW + 86400, frozenset({OTHER})))
    opened.store.save_list(number, data, NOW)


def granted(opened: SigningAuthority, cap: int) -> bytes:
    draft = Draft("home", "/a", KEY, NOW, cap, cap, bytes(16), (Permission("/t", Right.PUBLISH),))
    return document.grant_id(opened.issue_grant(draft, NOW))


def test_what_the_newest_list_lacks(opened: SigningAuthority) -> None:
    assert missing(opened) == frozenset()
    opened.store.revoke(KEY, "killed before it signed", NOW)
    assert missing(opened) == {KEY}
    opened.sign_list(NOW)
    assert missing(opened) == frozenset()
    lose(opened, b"l" * 32)
    assert missing(opened) == {KEY, b"l" * 32}


def test_what_ended_is_not_missing(opened: SigningAuthority) -> None:
    entry = granted(opened, NOW + 100)
    lose(opened, entry)
    assert missing(opened, NOW + 160) == {entry}
    assert missing(opened, NOW + 161) == frozenset()


def test_everything_is_missing_before_there_is_a_list(
    opened: SigningAuthority, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened.revoke(KEY, "", NOW)
    monkeypatch.setattr(opened.store, "newest_list", lambda: None)
    assert missing(opened) == {KEY}


HEALS: dict[str, Callable[[SigningAuthority], object]] = {
    "grant": lambda opened: granted(opened, NOW + 100),
    "revoke another": lambda opened: opened.revoke(OTHER, "", NOW),
    "revoke again": lambda opened: opened.revoke_identity("/never", "", NOW),
    "delegate": lambda opened: opened.issue_delegation(bytes(32), 86400, 3600, NOW),
    "refresh": lambda opened: opened.refresh_list(NOW),
}


@pytest.mark.parametrize("tree", [False, True])
@pytest.mark.parametrize("act", HEALS)
def test_every_command_that_signs_makes_good_what_was_lost(
    opened: SigningAuthority, act: str, tree: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose(opened, b"l" * 32)
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0 if tree else 4096)
    with suppress(ConfigurationError):  # there is nobody to revoke
        HEALS[act](opened)
    assert missing(opened) == frozenset()
    before = opened.store.next_number()
    opened.refresh_list(NOW)
    assert opened.store.next_number() == before


def test_the_entries_of_a_tree_are_in_the_record(
    home: AuthorityHome, opened: SigningAuthority, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
    opened.revoke(KEY, "", NOW)
    tree = open_tree(home.revocation_list(), home.own_key())
    assert signing.tree_entries(opened.store, tree).entries == {KEY}
    opened.store.revoke(OTHER, "killed before it signed", NOW)
    with pytest.raises(RevocationRefused, match="are not those of the signed tree"):
        signing.tree_entries(opened.store, tree)
    assert missing(opened) == {KEY, OTHER}
    with pytest.raises(ConfigurationError, match="the entries of the tree are missing"):
        home.newest_statement()[1]
    assert home.count_unlisted(NOW) == 2
    opened.refresh_list(NOW)
    assert home.count_unlisted(NOW) == 0


class SlowToken:
    """A key whose every signature gives somebody else the time to act."""

    def __init__(self, opened: SigningAuthority, meanwhile: Callable[[], object]) -> None:
        self._signer = opened.authority.signer
        self.public_key = self._signer.public_key
        self._meanwhile = meanwhile

    def sign(self, data: bytes) -> bytes:
        self._meanwhile()
        return self._signer.sign(data)


def test_a_second_signer_waits_for_the_first(home: AuthorityHome, opened: SigningAuthority) -> None:
    """In 180d0d3 both took the next list's number, and the slower one's revocation was lost."""
    other, refusals = home.unlock(PASSPHRASE), list[str]()
    other.store.database.connection.execute("PRAGMA busy_timeout = 0")

    def intrude() -> None:
        try:
            other.revoke(OTHER, "meanwhile", NOW)
        except RecordUnusable as error:
            refusals.append(str(error))

    opened.authority.signer = SlowToken(opened, intrude)
    assert opened.revoke(KEY, "first", NOW).entries == {KEY}
    assert refusals
    assert all("another command is using it, nothing was changed" in it for it in refusals)
    assert other.revoke(OTHER, "afterwards", NOW).entries == {KEY, OTHER}
    assert missing(opened) == frozenset()


def test_a_revocation_whose_list_cannot_be_signed_is_not_recorded(opened: SigningAuthority) -> None:
    def fail() -> None:
        raise ConfigurationError("the token was pulled out")

    opened.authority.signer = SlowToken(opened, fail)
    with pytest.raises(ConfigurationError, match="pulled out"):
        opened.revoke(KEY, "", NOW)
    assert opened.store.revoked_entries() == frozenset()
