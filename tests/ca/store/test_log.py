"""What an owner of the file could do to it, and how the audit finds it."""

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import LogDamaged, StoreError
from ca.revocation.merkle import EMPTY_ROOT
from ca.store import identities as request_record
from ca.store.record import Store
from ca.store.values import DAY, CertificateRow, GrantRow, extend_peaks, sign_head
from ca.svid import build_request, check_request
from tests.support.pki import NOW, new_signer

KEY = new_signer()
REQUESTS = [build_request(new_signer(), "home", name) for name in ("/a", "/b", "/c")]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ca.db"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    """A record with something of everything in it, and two signed heads."""
    store = Store.create(path)
    for der in REQUESTS:
        store.requests.add(check_request(der, "home"), der, "test", NOW)
    first, second, _ = (check_request(der, "home") for der in REQUESTS)
    store.requests.approve(first.digest, NOW)
    store.requests.deny(second.digest, NOW, "unknown")
    row = CertificateRow(1, "/a", first.thumbprint, b"der", NOW, NOW + DAY)
    store.add_certificate(row, NOW, request=first.digest)
    store.add_certificate(row._replace(serial=2, name="/d", thumbprint=b"d" * 32), NOW)
    store.add_grant(GrantRow(b"g" * 16, "/a", b"grant", NOW, NOW + DAY), NOW)
    store.save_list((1, 1), b"list", NOW)
    store.log.add_head(sign_head(KEY, store.log.head(NOW)), NOW)
    store.revoke(b"k" * 32, "lost", NOW)
    store.save_list((1, 2), b"list 2", NOW)
    store.log.add_head(sign_head(KEY, store.log.head(NOW)), NOW)
    yield store
    store.close()


def audited(store: Store) -> None:
    store.log.audit(KEY.public_key)


def tamper(path: Path, *statements: str) -> None:
    """As the owner of the file: the triggers are no obstacle."""
    with closing(sqlite3.connect(path)) as db:
        triggers = db.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for (name,) in triggers:
            db.execute(f"DROP TRIGGER {name}")
        for statement in statements:
            assert db.execute(statement).rowcount > 0, statement
        db.commit()


def test_an_empty_log(tmp_path: Path) -> None:
    with closing(Store.create(tmp_path / "new.db")) as store:
        assert store.log.head(NOW).root == EMPTY_ROOT
        assert store.log.audit(KEY.public_key).size == 0


def test_a_record_in_order(store: Store, monkeypatch: pytest.MonkeyPatch) -> None:
    newest = store.log.audit(KEY.public_key)
    assert newest.size == len(store.log.entries()) == len(store.log.tree())
    assert newest.root == store.log.tree().root()
    store.log_event("restored", "record", "", NOW)
    assert store.log.audit(KEY.public_key) == newest  # covers what was signed
    monkeypatch.setattr(request_record, "KEPT_EXPIRED", 0)
    store.requests.collect(NOW + 60 * DAY)
    audited(store)
    assert store.requests.all() == []


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("UPDATE log SET detail = 'x' WHERE number = 3", "log entry 3 was changed"),
        ("DELETE FROM log WHERE number = 3", "log entry 3 is missing"),
        ("UPDATE certificate SET name = '/x' WHERE name = '/d'", "the certificate of log entry"),
        ("UPDATE certificate SET not_after = 9", "the certificate of log entry [0-9]+ is missing"),
        ("DELETE FROM certificate WHERE name = '/d'", "the certificate of log entry"),
        ("UPDATE grant_ SET data = x'00'", "the grant of log entry"),
        ("DELETE FROM revocation", "the revocation of log entry [0-9]+ is missing or was changed"),
        ("UPDATE list SET data = x'00' WHERE seq = 2", "the list of log entry"),
        ("INSERT INTO revocation VALUES (x'01', '', 0)", "a revocation is recorded that is not"),
        ("INSERT INTO grant_ VALUES (x'01', '/m', x'', 0, 0, 0)", "a grant is recorded that is"),
        ("UPDATE csr SET state = 'approved' WHERE name = '/c'", "differ from the log"),
        ("DELETE FROM csr WHERE name = '/c'", "the states of the requests differ from the log"),
        ("UPDATE head SET data = x'00'", "not a signed head"),
    ],
)
def test_what_was_changed_is_found(store: Store, path: Path, statement: str, message: str) -> None:
    if "UPDATE head" in statement:
        statement += " WHERE rowid = 1"
    tamper(path, statement)
    with pytest.raises(LogDamaged, match=message):
        audited(store)


def rewrite(path: Path, change: str) -> None:
    """A careful forger computes everything anew, and has no key for the heads."""
    tamper(path, change)
    with closing(Store.open(path)) as store:
        entries, peaks = store.log.entries(), b""
    with closing(sqlite3.connect(path)) as db:
        for entry in entries:
            peaks = extend_peaks(peaks, entry)
            db.execute("UPDATE log SET peaks = ? WHERE number = ?", (peaks, entry.number))
        db.commit()


def test_a_rewritten_past_contradicts_the_heads(store: Store, path: Path) -> None:
    rewrite(path, "UPDATE log SET at = 0 WHERE number = 0")
    with pytest.raises(LogDamaged, match="entries of the log are not those that were signed"):
        audited(store)


def test_a_cut_log_contradicts_a_head_kept_elsewhere(store: Store, path: Path) -> None:
    kept = store.log.heads()[-1]
    size = store.log.head(NOW).size
    tamper(
        path,
        f"DELETE FROM log WHERE number = {size - 1}",
        "DELETE FROM head WHERE rowid = 2",
        "DELETE FROM list WHERE seq = 2",
    )
    audited(store)  # a file alone cannot tell
    with pytest.raises(LogDamaged, match="its end is missing"):
        store.log.audit(KEY.public_key, kept)


def test_a_forbidden_transition_in_the_log_is_found(store: Store, path: Path) -> None:
    for what in ("issued", "approved", "collected", "pending"):
        with closing(Store.create(path.with_name(what))) as other:
            with other.database.transaction() as db:
                from ca.store.database import append_entry

                append_entry(db, NOW, what, "/a", "", b"d" * 32)
            if what in {"issued", "approved"}:
                with pytest.raises(LogDamaged, match="log entry 0 is not an allowed transition of a request"):
                    audited(other)
            elif what == "pending":
                with pytest.raises(LogDamaged, match="the states of the requests differ"):
                    audited(other)
            else:
                audited(other)


def test_heads_are_kept_once(store: Store) -> None:
    before = store.log.heads()
    store.log.add_head(before[-1], NOW)
    assert store.log.heads() == before


def test_a_closed_record_has_no_journal(path: Path) -> None:
    store = Store.create(path)
    store.close()
    with pytest.raises(StoreError, match="cannot be used"):
        store.log.entries()
    with pytest.raises(StoreError, match="cannot be used"):
        store.database.snapshot()
