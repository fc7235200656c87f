import sqlite3
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from ca.errors import NameCovered, StoreError
from ca.store.record import CertificateRow, GrantRow, Store
from ca.svid import build_request
from tests.support import approving
from tests.support.pki import Site, new_signer

NOW, DAY = 1_800_000_000, 86_400
KEY, OTHER = b"k" * 32, b"o" * 32


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ca.db"


@pytest.fixture
def store(path: Path) -> Iterator[Store]:
    store = Store.create(path)
    yield store
    store.close()


def certificate(serial: int = 1, name: str = "/a", key: bytes = KEY) -> CertificateRow:
    return CertificateRow(serial, name, key, b"der%d" % serial, NOW, NOW + DAY)


def grant(number: int = 1) -> GrantRow:
    return GrantRow(bytes([number]) * 16, "/a", b"signed", NOW, NOW + DAY)


def entries(store: Store) -> list[tuple[int, str, str, str]]:
    return [entry[1:5] for entry in store.log.entries()]


def test_the_file_is_the_owners_alone(store: Store, path: Path) -> None:
    store.revoke(KEY, "lost", NOW)
    for file in path.parent.iterdir():
        assert stat.S_IMODE(file.stat().st_mode) == 0o600, file


def test_durability_is_asked_for(path: Path) -> None:
    Store.create(path).close()
    store = Store.open(path)
    (journal,) = store.database.connection.execute("PRAGMA journal_mode").fetchone()
    (synchronous,) = store.database.connection.execute("PRAGMA synchronous").fetchone()
    assert (journal, synchronous) == ("wal", 2)
    store.close()


def test_everything_is_there_after_reopening(store: Store, path: Path) -> None:
    largest = certificate((1 << 128) - 1)
    store.add_certificate(largest, NOW)
    store.add_grant(grant(), NOW)
    store.revoke(OTHER, "lost", NOW)
    store.save_list((1, 1), b"list", NOW)
    store.close()
    again = Store.open(path)
    assert again.identities.all() == [largest]
    assert again.grants() == [grant()]
    assert again.revoked_entries() == {OTHER}
    assert again.newest_list() == b"list"
    assert [entry.what for entry in again.log.entries()] == ["certificate", "grant", "revocation", "list"]
    again.close()


def test_every_change_leaves_a_line(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_grant(grant(), NOW + 1)
    store.revoke(OTHER, "lost", NOW + 2)
    store.save_list((1, 1), b"list", NOW + 3)
    assert entries(store) == [
        (NOW, "certificate", "/a", KEY.hex()),
        (NOW + 1, "grant", "/a", (b"\x01" * 16).hex()),
        (NOW + 2, "revocation", OTHER.hex(), "lost"),
        (NOW + 3, "list", "1.1", ""),
    ]


def test_revoking_twice_is_once(store: Store) -> None:
    store.revoke(KEY, "lost", NOW)
    store.revoke(KEY, "stolen", NOW + 1)
    assert store.revoked_entries() == {KEY}
    assert entries(store) == [(NOW, "revocation", KEY.hex(), "lost")]


def test_a_refused_entry_leaves_no_line(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_grant(grant(), NOW)
    store.save_list((1, 1), b"list", NOW)
    before = entries(store)
    with pytest.raises(StoreError, match="the record refuses the entry: UNIQUE"):
        store.add_certificate(certificate(name="/b"), NOW)
    with pytest.raises(StoreError, match="the record refuses the entry: UNIQUE"):
        store.add_grant(grant(), NOW)
    with pytest.raises(StoreError, match="the record refuses the entry: UNIQUE"):
        store.save_list((1, 1), b"other", NOW)
    assert entries(store) == before
    assert store.newest_list() == b"list"


def test_a_name_keeps_its_key(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_certificate(certificate(2), NOW)
    store.add_certificate(certificate(3, "/b", OTHER), NOW)
    with pytest.raises(StoreError, match="/a has an identity with another key") as caught:
        store.add_certificate(certificate(4, key=OTHER), NOW + DAY)
    assert "--replace-key /a" in caught.value.hint
    assert [row.serial for row in store.identities.all()] == [1, 2, 3]
    store.add_certificate(certificate(4, key=OTHER), NOW, replace_key="/a")


def test_an_expired_or_revoked_key_may_be_followed_by_another(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_certificate(certificate(2, key=OTHER), NOW + DAY + 1)
    store.revoke(OTHER, "lost", NOW + DAY + 1)
    store.add_certificate(certificate(3, key=b"n" * 32), NOW + DAY + 1)


def test_a_revoked_key_is_not_certified_again(store: Store) -> None:
    store.revoke(KEY, "stolen", NOW)
    with pytest.raises(StoreError, match="the key of /a is revoked") as caught:
        store.add_certificate(certificate(), NOW, replace_key="/a")
    assert "new key" in caught.value.hint
    assert store.identities.all() == []


def test_the_newest_live_certificate(store: Store) -> None:
    with pytest.raises(StoreError, match="/a has no valid identity here") as caught:
        store.valid_certificate("/a", NOW)
    assert "rossec node request /a" in caught.value.hint
    store.add_certificate(certificate(), NOW)
    store.add_certificate(certificate(2), NOW)
    store.add_certificate(certificate(3, "/b", OTHER), NOW)
    assert store.valid_certificate("/a", NOW + DAY).serial == 2
    with pytest.raises(StoreError, match="the identity of /a ended on 20") as caught:
        store.valid_certificate("/a", NOW + DAY + 1)
    assert "rossec ca renew --expired /a" in caught.value.hint
    store.revoke(KEY, "lost", NOW)
    for when in (NOW, NOW + DAY + 1):
        with pytest.raises(StoreError, match="the identity of /a is revoked") as caught:
            store.valid_certificate("/a", when)
        assert "move the directory of its key away" in caught.value.hint


def test_one_that_is_over_may_be_renewed_and_one_that_is_revoked_may_not(store: Store) -> None:
    over = NOW + DAY + 1
    with pytest.raises(StoreError, match="no valid identity"):
        store.renewable_certificate("/a", NOW, expired=True)
    store.add_certificate(certificate(), NOW)
    store.add_certificate(certificate(2), NOW)
    assert store.renewable_certificate("/a", NOW, expired=True).serial == 2
    assert store.renewable_certificate("/a", over, expired=True).serial == 2
    with pytest.raises(StoreError, match="ended on"):
        store.renewable_certificate("/a", over, expired=False)
    store.revoke(KEY, "lost", NOW)
    for when in (NOW, over):
        with pytest.raises(StoreError, match="is revoked"):
            store.renewable_certificate("/a", when, expired=True)


def test_an_older_key_does_not_come_back_in_the_place_of_a_revoked_one(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_certificate(certificate(2, key=OTHER), NOW, renews=KEY)
    store.revoke(OTHER, "stolen", NOW)
    with pytest.raises(StoreError, match="is revoked"):
        store.renewable_certificate("/a", NOW + DAY + 1, expired=True)


def test_valid_keys_are_neither_expired_nor_revoked(store: Store) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_certificate(certificate(2, key=OTHER), NOW, renews=KEY)
    store.add_certificate(certificate(3, "/b", b"b" * 32), NOW)
    assert store.unrevoked_keys("/a", NOW) == {KEY, OTHER}
    store.revoke(OTHER, "lost", NOW)
    assert store.unrevoked_keys("/a", NOW) == {KEY}
    assert store.valid_certificate("/a", NOW).thumbprint == KEY
    assert store.unrevoked_keys("/a", NOW + DAY + 1) == frozenset()


def test_lists_are_numbered(store: Store) -> None:
    assert store.newest_list() is None
    assert store.next_number() == (1, 1)
    store.save_list((1, 1), b"first", NOW)
    assert store.next_number() == (1, 2)
    store.save_list((2, 7), b"new epoch", NOW)
    store.save_list((1, 9), b"old epoch", NOW)
    assert store.next_number() == (2, 8)
    assert store.newest_list() == b"new epoch"


TABLES = ("certificate", "grant_", "revocation", "list", "log")


@pytest.mark.parametrize("table", TABLES)
def test_nothing_is_ever_changed_or_deleted(store: Store, path: Path, table: str) -> None:
    store.add_certificate(certificate(), NOW)
    store.add_grant(grant(), NOW)
    store.revoke(OTHER, "lost", NOW)
    store.save_list((1, 1), b"list", NOW)
    direct = sqlite3.connect(path)
    for statement in (f"UPDATE {table} SET at = 0", f"DELETE FROM {table}"):
        with pytest.raises(sqlite3.IntegrityError, match="the record is append-only"):
            direct.execute(statement)
    direct.close()


def test_types_are_strict(path: Path, store: Store) -> None:
    direct = sqlite3.connect(path)
    with pytest.raises(sqlite3.IntegrityError, match="cannot store TEXT value in INTEGER"):
        direct.execute("INSERT INTO revocation VALUES (x'00', 'reason', 'noon')")
    direct.close()


def test_damage_inside_is_our_error(path: Path) -> None:
    store = Store.create(path)
    for number in range(500):
        store.add_grant(GrantRow(number.to_bytes(16), "/a", bytes(1000), NOW, NOW), NOW)
    store.close()
    data = bytearray(path.read_bytes())
    data[64 * 4096 :] = b"\xff" * (len(data) - 64 * 4096)
    path.write_bytes(data)
    damaged = Store.open(path)
    with pytest.raises(StoreError, match="is damaged: ") as caught:
        damaged.grants()
    assert "restore it from a backup" in caught.value.hint
    with pytest.raises(StoreError, match="is damaged: "):
        damaged.add_grant(grant(), NOW)
    damaged.close()


def test_a_closed_record_cannot_be_written(path: Path) -> None:
    store = Store.create(path)
    store.close()
    with pytest.raises(StoreError, match=r"cannot be used: .*closed.*, nothing was changed"):
        store.revoke(KEY, "lost", NOW)


SITE = Site.create()


def real(serial: int, name: str, key: bytes = KEY, *, wildcard: bool = False) -> CertificateRow:
    csr = build_request(new_signer(), "home", name)
    der = SITE.authority.issue(csr, now=NOW, serial=serial, wildcard=wildcard)
    return CertificateRow(serial, name, key, der, NOW, NOW + DAY)


@pytest.mark.parametrize("wildcard", [False, True])
@pytest.mark.parametrize("first", [0, 1])
def test_two_keys_never_go_by_one_name(store: Store, first: int, *, wildcard: bool) -> None:
    rows = [real(1, "/rviz", wildcard=True), real(2, "/rviz_17", OTHER, wildcard=wildcard)]
    store.add_certificate(rows[first], NOW)
    with pytest.raises(NameCovered, match="is for anonymous nodes and covers the other") as caught:
        store.add_certificate(rows[1 - first], NOW, replace_key="/a")
    assert f"revoke {rows[first].name} first" in caught.value.hint
    store.revoke(rows[first].thumbprint, "no more", NOW)
    store.add_certificate(rows[1 - first], NOW)


def test_a_wildcard_tail_does_not_block_other_names(store: Store) -> None:
    store.add_certificate(real(1, "/rviz", wildcard=True), NOW)
    store.add_certificate(real(2, "/rvizx", OTHER), NOW)
    store.add_certificate(real(3, "/robot1/rviz_1", OTHER), NOW)
    store.add_certificate(real(4, "/rviz_17"), NOW)  # the same key
    store.add_certificate(real(5, "/rviz_18", OTHER), NOW + DAY + 1)  # expired by then
    store.add_certificate(real(6, "/plain"), NOW)
    store.add_certificate(real(7, "/plain_1", OTHER), NOW)


def test_the_name_an_anonymous_node_is_certified_under(store: Store) -> None:
    store.add_certificate(real(1, "/rviz", wildcard=True), NOW)
    store.add_certificate(real(2, "/plain", OTHER), NOW)
    names = {"/rviz": "/rviz", "/rviz_1": "/rviz", "/plain_1": "/plain_1", "/new": "/new"}
    assert {name: store.identities.certified_name(name, NOW) for name in names} == names
    with pytest.raises(StoreError, match="/rviz_1 has no valid identity") as caught:
        store.valid_certificate("/rviz_1", NOW)
    assert caught.value.hint == "it is one of the anonymous nodes of /rviz: name that"
    assert store.identities.certified_name("/rviz_1", NOW + DAY + 1) == "/rviz_1"
    store.revoke(KEY, "lost", NOW)
    assert store.identities.certified_name("/rviz_1", NOW) == "/rviz_1"


def test_the_key_that_is_replaced_is_revoked_in_the_same_step(store: Store) -> None:
    store.add_certificate(certificate(1), NOW)
    store.add_certificate(certificate(2, key=OTHER), NOW, replace_key="/a")
    assert store.revoked_entries() == {certificate(1).thumbprint}
    assert store.unrevoked_keys("/a", NOW) == {certificate(2, key=OTHER).thumbprint}


def test_the_grants_that_are_not_revoked(store: Store) -> None:
    for number in (1, 2):
        store.add_grant(grant(number), NOW)
    store.add_grant(grant(3)._replace(name="/b"), NOW)
    store.revoke(grant(1).id, "no", NOW)
    assert [row.id[0] for row in store.unrevoked_grants()] == [2, 3]
    assert [row.id[0] for row in store.unrevoked_grants(["/b"])] == [3]
    assert [row.id[0] for row in store.unrevoked_grants(["/b", "/a"])] == [2, 3]
    assert store.unrevoked_grants([]) == []


def test_when_grants_were_signed_and_which_were_revoked(store: Store) -> None:
    store.add_grant(grant(1), NOW)
    store.add_grant(grant(2), NOW + 1)
    store.revoke(grant(1).id, "no", NOW + 2)
    assert store.signed_at() == {grant(1).id: NOW, grant(2).id: NOW + 1}
    assert [row.id for row in store.revoked_grants()] == [grant(1).id]


def test_an_event_without_a_table_is_logged(store: Store) -> None:
    store.log_event("restored", "record", "from a backup", NOW)
    last = store.log.entries()[-1]
    assert (last.what, last.subject, last.detail) == ("restored", "record", "from a backup")


def test_a_phone_that_is_removed_takes_what_waits_with_it(store: Store) -> None:
    store.passkeys.add(approving.PASSKEY)
    store.approvals.add(approving.approve(store))
    store.remove_passkey(approving.PASSKEY.id, "lost", approving.NOW)
    assert store.passkeys.active() == []
    assert store.approvals.waiting() == []
    (end,) = store.approvals.ends().values()
    assert (end.state, end.result) == ("failed", "its phone was removed: lost")
