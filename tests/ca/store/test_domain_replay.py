"""What the audit finds in the record of foreign domains that was rewritten, log and all."""

import dataclasses
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from ca.domains import DomainList, ForeignDomain, sign_domains
from ca.errors import LogDamaged
from ca.keys.signing import KeySigner
from ca.revocation.merkle import Tree
from ca.store.log import Replay
from ca.store.record import Store
from ca.store.values import LogEntry
from tests.support.domains import foreign
from tests.support.pki import NOW, Site, new_signer

Change = Callable[["Record"], None]


class Record:
    """A record of a home that has listed a hospital, and removed it."""

    def __init__(self, path: Path) -> None:
        self.store = Store.create(path)
        self.home, self.hospital = Site.create("home"), foreign(Site.create("hospital.example"))
        self.store.domains.accept(self.hospital, NOW)
        self.list(self.hospital)
        self.store.domains.end("hospital", "", NOW)
        self.list()

    def list(self, *entries: ForeignDomain, number: tuple[int, int] | None = None) -> None:
        """Sign and record a list."""
        found = number or self.store.domains.next_number()
        listed = DomainList(*found, NOW, NOW + 9, entries)
        data = sign_domains(KeySigner(self.home.key), listed, "home")
        self.store.domains.save_list(found, data, NOW)

    def audit(self) -> None:
        self.store.log.audit(self.home.anchor.public_key)


@pytest.fixture
def record(tmp_path: Path) -> Iterator[Record]:
    made = Record(tmp_path / "ca.db")
    yield made
    made.store.close()


def test_what_was_done_is_in_order(record: Record) -> None:
    record.audit()
    with pytest.raises(LogDamaged, match="log entry 1: not a list of domains"):
        record.store.log.audit(new_signer().public_key)


def test_domains_may_end_in_any_order(record: Record) -> None:
    for name in ("cafe", "office", "zoo"):
        record.store.domains.accept(foreign(Site.create(name), name), NOW)
    for name in ("zoo", "cafe", "office"):
        record.store.domains.end(name, f"{name} is over", NOW)
    record.audit()


def list_of_a_removed_domain(record: Record) -> None:
    record.list(record.hospital)


def list_with_other_terms(record: Record) -> None:
    record.store.domains.accept(record.hospital, NOW)
    record.list(dataclasses.replace(record.hospital, admitted=("/**",)))


def list_of_an_old_number(record: Record) -> None:
    record.store.domains.save_list((0, 7), record.store.domains.newest_list(), NOW)


def list_of_another_key(record: Record) -> None:
    data = sign_domains(new_signer(), DomainList(1, 3, NOW, NOW + 9), "home")
    record.store.domains.save_list((1, 3), data, NOW)


def terms_that_are_none(record: Record) -> None:
    hidden = Hidden(record.hospital)
    record.store.domains.accept(hidden, NOW)  # type: ignore[arg-type]


class Hidden:
    """A domain that records other terms than its own."""

    def __init__(self, real: ForeignDomain) -> None:
        self.domain, self.label, self.anchor = real.domain, real.label, real.anchor
        self.terms = b"\x80"


def terms_of_another(record: Record) -> None:
    hidden = Hidden(record.hospital)
    hidden.terms = foreign(Site.create("cafe"), "cafe").terms
    record.store.domains.accept(hidden, NOW)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (list_of_a_removed_domain, "domain list, which cannot be"),
        (list_with_other_terms, "domain list, which cannot be"),
        (list_of_an_old_number, "domain list, which cannot be"),
        (list_of_another_key, "not a list of domains of this authority"),
        (terms_that_are_none, "log entry 4: a domain of the list has missing"),
        (terms_of_another, "domain, which cannot be"),
    ],
    ids=lambda value: getattr(value, "__name__", None),
)
def test_what_cannot_have_been(record: Record, change: Change, message: str) -> None:
    change(record)
    with pytest.raises(LogDamaged, match=message) as caught:
        record.audit()
    assert caught.value.hint


def test_an_end_without_a_beginning_and_a_label_twice(record: Record) -> None:
    key, cafe = record.home.anchor.public_key, foreign(Site.create("cafe"), "hospital")
    other = (9, "cafe", "hospital", cafe.anchor.thumbprint, cafe.terms, NOW)
    (first,) = record.store.domains.all()
    rows: dict[str, list[tuple[Any, ...]]] = {
        "domain": [first, other],
        "domain ended": [(7, "", NOW)],
        "domain list": [],
    }

    def replay_domains(*kinds: str) -> None:
        done = Replay(rows, Tree(), key)
        for number, kind in enumerate(kinds):
            done.take(LogEntry(number, NOW, kind, "", "", b""))

    replay_domains("domain")
    with pytest.raises(LogDamaged, match="the label hospital is that of domain"):
        replay_domains("domain", "domain")
    with pytest.raises(LogDamaged, match="domain ended, which cannot be"):
        replay_domains("domain", "domain ended")


def test_a_changed_row_is_found_by_its_digest(record: Record) -> None:
    db: sqlite3.Connection = record.store.database.connection
    db.execute("DROP TRIGGER foreign_domain_no_UPDATE")
    db.execute("UPDATE foreign_domain SET label = 'clinic'")
    with pytest.raises(LogDamaged, match="the domain of log entry 0 is missing or was changed"):
        record.audit()


def test_the_tables_are_append_only(tmp_path: Path) -> None:
    with closing(Store.create(tmp_path / "new.db")) as store:
        cafe = foreign(Site.create("cafe"), "cafe")
        store.domains.accept(cafe, NOW)
        store.domains.end("cafe", "", NOW)
        for table in ("foreign_domain", "foreign_domain_end"):
            with pytest.raises(sqlite3.IntegrityError, match="append-only"):
                store.database.connection.execute(f"DELETE FROM {table}")
