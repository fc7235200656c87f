from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.errors import CAError, StoreError
from ca.store.record import Store
from ca.store.values import CertificateRow
from tests.support import refusal_texts
from tests.support.pki import DAY, NOW

OLD, NEW, THIRD = (bytes([number]) * 32 for number in range(3))


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as store:
        store.add_certificate(row(1, OLD), NOW)
        yield store


def row(serial: int, key: bytes, name: str = "/a") -> CertificateRow:
    return CertificateRow(serial, name, key, b"der", NOW, NOW + DAY)


def test_the_newest_key_may_name_its_successor(store: Store) -> None:
    store.add_certificate(row(2, NEW), NOW, renews=OLD)
    store.add_certificate(row(3, NEW), NOW, renews=NEW)
    assert [found.serial for found in store.identities.by_name("/a")] == [1, 2, 3]
    assert store.unrevoked_keys("/a", NOW) == {OLD, NEW}
    assert store.valid_certificate("/a", NOW).serial == 3


def test_an_older_key_may_not(store: Store) -> None:
    store.add_certificate(row(2, NEW), NOW, renews=OLD)
    with pytest.raises(CAError, match="/a was renewed already, by another key"):
        store.add_certificate(row(3, THIRD), NOW, renews=OLD)


def test_a_name_nobody_knows_here_has_only_its_proof(store: Store) -> None:
    store.add_certificate(row(2, NEW, "/elsewhere"), NOW, renews=THIRD)


def test_a_renewal_of_a_revoked_key_is_none(store: Store) -> None:
    store.revoke(NEW, "lost", NOW)
    with pytest.raises(StoreError, match="the key of /a is revoked"):
        store.add_certificate(row(2, NEW), NOW, renews=OLD)


def test_after_a_renewal_both_keys_are_known(store: Store) -> None:
    store.add_certificate(row(2, NEW), NOW, renews=OLD)
    with pytest.raises(StoreError, match=refusal_texts.KEY_CHANGED):
        store.add_certificate(row(3, THIRD), NOW)
    store.add_certificate(row(3, THIRD), NOW, replace_key="/a")


def test_a_renewal_is_answered_once(store: Store) -> None:
    store.add_certificate(row(2, NEW), NOW, request=b"r" * 32, renews=OLD)
    assert store.identities.issued_for(b"r" * 32) == row(2, NEW)
    with pytest.raises(StoreError, match="has its certificate already"):
        store.add_certificate(row(3, THIRD), NOW, request=b"r" * 32, renews=NEW)


def test_all_valid_identities_at_once(store: Store) -> None:
    store.add_certificate(row(2, NEW, "/b"), NOW)
    store.add_certificate(row(3, THIRD, "/c")._replace(not_after=NOW), NOW)
    assert [each.name for each in store.identities.all_valid(NOW)] == ["/a", "/b", "/c"]
    assert [each.name for each in store.identities.all_valid(NOW + 1)] == ["/a", "/b"]
    store.revoke(NEW, "lost", NOW)
    assert [each.name for each in store.identities.all_valid(NOW + 1)] == ["/a"]


@pytest.mark.parametrize("name", ["/", "/ab", "/a/b", "/b", "/a~", "/A", "/é", "/a" + "z" * 200])
def test_names_with_a_common_beginning_are_compared_whatever_their_order(store: Store, name: str) -> None:
    compared = list[str]()

    def covers(other: str) -> bool:
        compared.append(other)
        return False

    store.add_certificate(row(2, NEW, name), NOW)
    for asked in ("/a", "/a/b/c", "/abc", "/é"):
        compared.clear()
        store.identities.check_names(asked, THIRD, NOW, covers)
        related = {other for other in ("/a", name) if asked.startswith(other) or other.startswith(asked)}
        assert set(compared) == related - {asked}


def test_the_valid_identities_of_masters(store: Store) -> None:
    names = ["/master", "/masters", "/master/a", "/master/a/b", "/robot", "/robot/master", "/master/b"]
    for serial, name in enumerate(names, 101):
        store.add_certificate(row(serial, bytes([serial]) * 32, name), NOW)
    found = [each.name for each in store.identities.valid_masters(NOW)]
    assert found == ["/master", "/master/a", "/master/b"]
    store.revoke(bytes([103]) * 32, "stolen", NOW)
    assert [each.name for each in store.identities.valid_masters(NOW)] == ["/master", "/master/b"]
    assert store.identities.valid_masters(NOW + 400 * DAY) == []
