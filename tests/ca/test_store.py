import sqlite3
import stat
from pathlib import Path

import pytest

from ca.errors import KeyChanged, StoreError
from ca.store import CertificateRow, GrantRow, Store

NOW = 1_800_000_000


def certificate(
    name: str = "/robot", key: bytes = b"k" * 32, serial: int = 1, end: int = NOW + 100
) -> CertificateRow:
    return CertificateRow(serial, name, key, b"der", NOW - 100, end)


GRANT = GrantRow(b"g" * 16, "/robot", b"signed", NOW, NOW + 10)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ca.db"


@pytest.fixture
def store(path: Path) -> Store:
    return Store.create(path)


def test_a_new_record_is_private_and_empty(store: Store, path: Path) -> None:
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    assert (store.certificates(), store.grants(), store.log()) == ([], [], [])
    assert (store.newest_list(), store.next_number()) == (None, (1, 1))


def test_what_was_recorded_is_read_back_after_a_restart(store: Store, path: Path) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_grant(GRANT, NOW)
    store.revoke(GRANT.id, "moved out", NOW)
    store.save_list((1, 1), b"list", NOW)
    store.close()
    again = Store.open(path)
    assert again.certificates() == [certificate()]
    assert again.grants() == [GRANT]
    assert again.revoked_entries() == {GRANT.id}
    assert (again.newest_list(), again.next_number()) == (b"list", (1, 2))
    assert [row.what for row in again.log()] == ["certificate", "grant", "revocation", "list"]


def test_the_highest_list_is_the_newest(store: Store) -> None:
    for number in ((1, 1), (1, 10), (1, 9)):
        store.save_list(number, b"%d.%d" % number, NOW)
    assert store.newest_list() == b"1.10"
    assert store.next_number() == (1, 11)


def test_revoking_twice_is_revoking_once(store: Store) -> None:
    store.revoke(GRANT.id, "first", NOW)
    store.revoke(GRANT.id, "second", NOW + 1)
    assert [row.detail for row in store.log()] == ["first"]


def test_the_newest_living_identity(store: Store) -> None:
    store.add_certificate(certificate(serial=1, end=NOW - 1), NOW - 50)
    store.add_certificate(certificate(serial=2), NOW)
    store.add_certificate(certificate(serial=3, name="/other"), NOW)
    assert store.live_certificate("/robot", NOW).serial == 2
    with pytest.raises(StoreError, match="no valid identity here") as caught:
        store.live_certificate("/nobody", NOW)
    assert "rossec node request /nobody" in caught.value.hint


def test_another_key_for_a_living_name_needs_to_be_said(store: Store) -> None:
    store.add_certificate(certificate(serial=1), NOW)
    other = certificate(serial=2, key=b"o" * 32)
    with pytest.raises(KeyChanged, match="another key") as caught:
        store.add_certificate(other, NOW)
    assert "--new-key" in caught.value.hint
    assert len(store.certificates()) == 1
    store.add_certificate(other, NOW, allow_new_key=True)
    assert len(store.certificates()) == 2


def test_another_key_for_a_dead_name_is_free(store: Store) -> None:
    store.add_certificate(certificate(serial=1, end=NOW - 1), NOW - 50)
    store.add_certificate(certificate(serial=2, key=b"o" * 32), NOW)


def test_a_serial_is_used_once_and_the_log_agrees(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    with pytest.raises(StoreError, match="refuses the entry"):
        store.add_certificate(certificate(), NOW)
    assert len(store.log()) == 1


@pytest.mark.parametrize("table", ["certificate", "grant_", "revocation", "list", "log"])
@pytest.mark.parametrize("change", ["DELETE FROM {}", "UPDATE {} SET at = 0"])
def test_nothing_is_changed_or_deleted(store: Store, path: Path, table: str, change: str) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_grant(GRANT, NOW)
    store.revoke(GRANT.id, "", NOW)
    store.save_list((1, 1), b"list", NOW)
    other = sqlite3.connect(path)
    with pytest.raises(sqlite3.IntegrityError, match="append-only"):
        other.execute(change.format(table))
    other.close()


def test_a_record_is_not_overwritten(store: Store, path: Path) -> None:
    with pytest.raises(StoreError, match="cannot create"):
        Store.create(path)


def test_no_record(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="there is no record"):
        Store.open(tmp_path / "nothing.db")


@pytest.mark.parametrize("content", [b"this is no database at all" * 100, b"\0" * 4096])
def test_a_damaged_record(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(StoreError, match=r"no database|damaged|not a record"):
        Store.open(path)


def test_a_database_of_somebody_else(path: Path) -> None:
    other = sqlite3.connect(path)
    other.execute("CREATE TABLE x (y)")
    other.commit()
    other.close()
    with pytest.raises(StoreError, match="not a record of this version"):
        Store.open(path)


def test_a_record_that_cannot_be_read_or_written(store: Store) -> None:
    store.close()
    with pytest.raises(StoreError, match="cannot be read"):
        store.certificates()
    with pytest.raises(StoreError, match="cannot be written"):
        store.revoke(b"g" * 16, "", NOW)
