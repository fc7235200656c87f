"""What could not have been done, though every row is in the log with its digest."""

import hashlib
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from ca.approvals.passkeys import Approval, to_approve
from ca.approvals.statement import GrantStatement, StatementKind
from ca.errors import LogDamaged
from ca.store import database
from ca.store.log import RESTORED, ApprovalState
from ca.store.record import Store
from ca.store.values import digest_of
from tests.support import passkeys
from tests.support.approving import NOW, WHATS, approve, registered, state, touch
from tests.support.pki import new_signer

DEVICE = passkeys.Passkey(counts=False)
PHONE = registered(DEVICE)
OTHER = passkeys.Passkey(counts=False)


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as store:
        store.passkeys.add(PHONE)
        yield store


def audited(store: Store) -> None:
    store.log.audit(new_signer().public_key)


def write(store: Store, what: str, row: tuple[Any, ...]) -> None:
    """A row and its log entry, as who owns the file could write them."""
    table, _ = database.LOGGED_TABLES[what]
    marks = ", ".join("?" * len(row))
    with store.transaction() as db:
        db.execute(f"INSERT INTO {table} VALUES ({marks})", row)
        database.append_entry(db, NOW, what, "", "", digest_of(row))


def test_what_was_done_in_order_is_accepted(store: Store) -> None:
    new = registered(OTHER, "Bob's phone")
    addition = approve(store, to_approve(new), device=DEVICE)
    store.approvals.add(addition)
    store.passkeys.add(new._replace(approval=addition.id))
    store.approvals.end(addition.id, ApprovalState.DONE, "", NOW)
    store.approvals.add(approve(store, id=b"j" * 16, device=OTHER))
    store.passkeys.end(DEVICE.id, "lost", NOW)
    store.log_event(RESTORED, "record", "", NOW)
    store.approvals.end_waiting("restored", NOW)
    store.passkeys.end_all("restored", NOW)
    audited(store)


Forgery = Callable[[Store], tuple[Any, ...]]


def by_a_stranger(store: Store) -> Approval:
    return approve(store, device=OTHER)


def by_a_removed_phone(store: Store) -> Approval:
    store.passkeys.end(DEVICE.id, "lost", NOW)
    return approve(store, device=DEVICE)


def by_another_key(store: Store) -> Approval:
    forger = passkeys.Passkey()
    forger.id = DEVICE.id
    return approve(store, device=forger)


def about_another_log(store: Store) -> Approval:
    return touch(state(WHATS[StatementKind.DELEGATE], store=store)._replace(log_root=bytes(32)), b"", DEVICE)


def about_the_future(store: Store) -> Approval:
    statement = state(WHATS[StatementKind.DELEGATE], store=store)
    return touch(statement._replace(log_size=9), b"", DEVICE)


def from_before_a_restore(store: Store) -> Approval:
    approval = approve(store, device=DEVICE)
    store.log_event(RESTORED, "record", "", NOW)
    return approval


def with_another_payload(store: Store) -> Approval:
    what = GrantStatement(b"r" * 16, hashlib.sha256(b"shown").digest())
    return approve(store, what, b"wider", device=DEVICE)


def too_late(store: Store) -> Approval:
    return approve(store, device=DEVICE)._replace(at=NOW + 301)


@pytest.mark.parametrize(
    ("forged", "message"),
    [
        (by_a_stranger, "says approval, which cannot be"),
        (by_a_removed_phone, "says approval, which cannot be"),
        (by_another_key, "did not sign this"),
        (about_another_log, "says approval, which cannot be"),
        (about_the_future, "says approval, which cannot be"),
        (from_before_a_restore, "says approval, which cannot be"),
        (with_another_payload, "not what was shown"),
        (too_late, "did not come in time"),
    ],
)
def test_an_approval_that_nobody_made_is_found(store: Store, forged: Forgery, message: str) -> None:
    write(store, "approval", forged(store))
    with pytest.raises(LogDamaged, match=f"^log entry [12]:? .*{message}"):
        audited(store)


@pytest.mark.parametrize("change", [{"cose_key": OTHER.cose_key}, {"name": "Eve"}, {"approval": b"x"}])
def test_a_passkey_that_nobody_approved_is_found(store: Store, change: dict[str, Any]) -> None:
    new = registered(passkeys.Passkey(), "Bob's phone")
    addition = approve(store, to_approve(new), device=DEVICE)
    store.approvals.add(addition)
    write(store, "passkey", new._replace(**{"approval": addition.id, **change}))
    with pytest.raises(LogDamaged, match="log entry 2 says passkey, which cannot be"):
        audited(store)


@pytest.mark.parametrize(
    ("what", "row"),
    [("passkey ended", (b"unknown", "", NOW)), ("approval ended", (b"x" * 16, "done", "", NOW))],
)
def test_an_end_of_what_never_was_is_found(store: Store, what: str, row: tuple[Any, ...]) -> None:
    write(store, what, row)
    with pytest.raises(LogDamaged, match=f"log entry 1 says {what}, which cannot be"):
        audited(store)
