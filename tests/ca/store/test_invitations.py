import hashlib
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import JoinRefused, LogDamaged, StoreError
from ca.store.identities import InvitationRow, InvitationUse
from ca.store.record import Store
from tests.support.pki import new_signer

NOW = 1_800_000_000
KEY = b"\x04" + bytes(64)
ID = hashlib.sha256(KEY).digest()
ROW = InvitationRow(ID, KEY, "/robot*", 2, False, NOW + 3600, NOW)


def use(number: int, at: int = NOW) -> InvitationUse:
    digest = number.to_bytes(32)
    return InvitationUse(ID, digest, f"/robot{number}", digest, at)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ca.db"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    with closing(Store.create(path)) as store:
        store.invitations.add(ROW)
        yield store


def test_an_invitation_is_recorded_as_given(store: Store) -> None:
    assert store.invitations.get(ID) == ROW
    assert store.invitations.all() == [ROW]
    assert store.invitations.check_open(ID, NOW) == ROW
    wild = hashlib.sha256(b"k").digest()
    store.invitations.add(ROW._replace(id=wild, key=b"k", wildcard=True))
    assert store.invitations.get(wild).wildcard is True
    store.log.audit(new_signer().public_key)


def test_an_invitation_is_recorded_once(store: Store) -> None:
    with pytest.raises(StoreError, match="refuses the entry"):
        store.invitations.add(ROW)


def test_the_id_of_an_invitation_is_that_of_its_key(store: Store) -> None:
    with pytest.raises(ValueError, match="hash of its key"):
        store.invitations.add(ROW._replace(key=b"other"))


def test_each_use_is_counted_and_the_same_request_once(store: Store) -> None:
    store.invitations.take(use(1))
    store.invitations.take(use(1, NOW + 9))
    store.invitations.take(use(2))
    assert store.invitations.uses(ID) == [use(1), use(2)]
    with pytest.raises(JoinRefused, match="has had its 2 uses"):
        store.invitations.take(use(3))
    with pytest.raises(JoinRefused, match="has had its 2 uses"):
        store.invitations.check_open(ID, NOW)
    store.invitations.take(use(2))  # its answer was lost
    assert [entry.what for entry in store.log.entries()] == ["invitation", "join", "join"]
    store.log.audit(new_signer().public_key)


def test_an_expired_invitation_is_refused(store: Store) -> None:
    store.invitations.take(use(1, ROW.expires))
    with pytest.raises(JoinRefused, match="has expired"):
        store.invitations.take(use(2, ROW.expires + 1))


def test_an_unknown_invitation_is_refused(store: Store) -> None:
    for call in (
        lambda: store.invitations.get(bytes(32)),
        lambda: store.invitations.take(use(1)._replace(invitation=bytes(32))),
        lambda: store.invitations.end(bytes(32), "", NOW),
    ):
        with pytest.raises(JoinRefused, match="no such invitation"):
            call()


def test_an_ended_invitation_is_refused(store: Store) -> None:
    assert store.invitations.ended(ID) is None
    store.invitations.end(ID, "leaked", NOW)
    store.invitations.end(ID, "again", NOW)
    assert store.invitations.ended(ID) == "leaked"
    with pytest.raises(JoinRefused, match="was ended: leaked"):
        store.invitations.take(use(1))
    store.log.audit(new_signer().public_key)


def test_all_that_can_still_be_used_are_ended(store: Store) -> None:
    old = hashlib.sha256(b"old").digest()
    store.invitations.add(ROW._replace(id=old, key=b"old", expires=NOW - 1))
    store.invitations.end_all("restored", NOW)
    assert store.invitations.ended(ID) == "restored"
    assert store.invitations.ended(old) == "restored", "the clock may have been ahead"


def test_a_use_that_is_rolled_back_can_be_taken_again(store: Store) -> None:
    def issue(number: int, *, fails: bool) -> None:
        with store.transaction():
            store.invitations.take(use(number))
            if fails:
                raise StoreError("no identity")

    with pytest.raises(StoreError):
        issue(1, fails=True)
    issue(2, fails=False)
    assert store.invitations.uses(ID) == [use(2)]


def test_a_changed_invitation_is_found_by_the_audit(store: Store, path: Path) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            db.execute("UPDATE invitation SET uses = 99")
        db.execute("DROP TRIGGER invitation_no_UPDATE")
        db.execute("UPDATE invitation SET uses = 99")
    with pytest.raises(LogDamaged, match="the invitation of log entry 0"):
        store.log.audit(new_signer().public_key)
