import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import ApprovalRefused, LogDamaged, StoreError
from ca.store.record import Store
from tests.support import passkeys, refusal_texts
from tests.support.approving import NOW, PASSKEY, registered
from tests.support.pki import new_signer

OTHER = registered(passkeys.Passkey(), "Bob's phone", NOW + 1)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ca.db"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    with closing(Store.create(path)) as store:
        store.passkeys.add(PASSKEY)
        store.passkeys.add(OTHER)
        yield store


def test_passkeys_are_recorded_as_given(store: Store) -> None:
    assert store.passkeys.all() == store.passkeys.active() == [PASSKEY, OTHER]
    assert store.passkeys.get(OTHER.id) == OTHER
    assert [(entry.what, entry.subject) for entry in store.log.entries()] == [
        ("passkey", "Ann's phone"),
        ("passkey", "Bob's phone"),
    ]
    store.log.audit(new_signer().public_key)


def test_an_unknown_passkey_is_refused(store: Store) -> None:
    for call in (lambda: store.passkeys.get(b"unknown"), lambda: store.passkeys.end(b"unknown", "", NOW)):
        with pytest.raises(ApprovalRefused, match="is not registered here, or was removed") as error:
            call()
        assert error.value.hint == "register the phone: rossec console phone"


def test_a_passkey_that_has_ended_never_comes_back(store: Store) -> None:
    store.passkeys.end(PASSKEY.id, "lost", NOW)
    assert store.passkeys.active() == [OTHER]
    assert store.passkeys.ended() == {PASSKEY.id: "lost"}
    for call in (
        lambda: store.passkeys.get(PASSKEY.id),
        lambda: store.passkeys.end(PASSKEY.id, "again", NOW),
    ):
        with pytest.raises(ApprovalRefused, match=refusal_texts.PASSKEY_UNKNOWN):
            call()
    with pytest.raises(StoreError, match="refuses the entry"):
        store.passkeys.add(PASSKEY)
    store.log.audit(new_signer().public_key)


def test_two_passkeys_in_use_have_two_names(store: Store) -> None:
    another = registered(passkeys.Passkey())
    with pytest.raises(StoreError, match='there is a passkey called "Ann\'s phone"'):
        store.passkeys.add(another)
    store.passkeys.end(PASSKEY.id, "lost", NOW)
    store.passkeys.add(another)
    assert store.passkeys.active() == [OTHER, another]


def test_all_passkeys_are_ended_at_once(store: Store) -> None:
    assert store.passkeys.end_all("restored", NOW) == 2
    assert store.passkeys.end_all("restored", NOW) == 0
    assert store.passkeys.active() == []
    assert set(store.passkeys.ended().values()) == {"restored"}


@pytest.mark.parametrize("change", ["UPDATE passkey SET name = 'x'", "DELETE FROM passkey"])
def test_a_changed_passkey_is_found_by_the_audit(store: Store, path: Path, change: str) -> None:
    with closing(sqlite3.connect(path, isolation_level=None)) as db:
        with pytest.raises(sqlite3.IntegrityError, match="append-only"):
            db.execute(change)
        db.execute(f"DROP TRIGGER passkey_no_{change.split(maxsplit=1)[0]}")
        db.execute(change)
    with pytest.raises(LogDamaged, match="the passkey of log entry 0"):
        store.log.audit(new_signer().public_key)
