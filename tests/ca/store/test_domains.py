import dataclasses
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from ca.domains import ForeignDomain
from ca.errors import DomainUnknown, StoreError
from ca.store.record import Store
from ca.store.signed_statements import DomainRow, check_domains_apart
from tests.support.domains import SomeNode, foreign
from tests.support.pki import NOW, Site


@pytest.fixture
def store(tmp_path: Path) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as made:
        yield made


@pytest.fixture
def hospital() -> ForeignDomain:
    return foreign(Site.create("hospital.example"))


def labels(store: Store) -> list[str]:
    return [row.label for row in store.domains.accepted()]


def test_a_domain_is_accepted_changed_and_ended(store: Store, hospital: ForeignDomain) -> None:
    store.domains.accept(hospital, NOW)
    narrower = dataclasses.replace(hospital, admitted=("/a",))
    store.domains.accept(narrower, NOW + 1)
    held = store.domains.get("hospital")
    assert held.read() == narrower
    assert (held.number, held.domain, held.at) == (2, "hospital.example", NOW + 1)
    assert held.root == hospital.anchor.thumbprint
    assert store.domains.end("hospital", "the visit is over", NOW + 2) == held
    assert labels(store) == []
    assert store.domains.ends() == {2: ("the visit is over", NOW + 2)}
    assert [row.read() for row in store.domains.all()] == [hospital, narrower]
    store.domains.accept(hospital, NOW + 3)
    assert labels(store) == ["hospital"]
    assert [(e.what, e.subject, e.detail) for e in store.log.entries()] == [
        ("domain", "hospital.example", "hospital"),
        ("domain", "hospital.example", "hospital"),
        ("domain ended", "hospital.example", "the visit is over"),
        ("domain", "hospital.example", "hospital"),
    ]


def test_an_unknown_label(store: Store, hospital: ForeignDomain) -> None:
    with pytest.raises(DomainUnknown, match="no domain is called 'hospital' here") as caught:
        store.domains.get("hospital")
    assert "rossec domain list" in caught.value.hint
    store.domains.accept(hospital, NOW)
    store.domains.end("hospital", "", NOW)
    with pytest.raises(DomainUnknown):
        store.domains.end("hospital", "", NOW)


def test_domains_are_sorted_and_told_by_their_labels(store: Store) -> None:
    for domain, label in (("zoo", "a"), ("cafe", "z")):
        store.domains.accept(foreign(Site.create(domain), label), NOW)
    assert labels(store) == ["z", "a"]
    store.domains.end("z", "", NOW)
    office = foreign(Site.create("office"), "z")
    store.domains.accept(office, NOW)
    assert [row.domain for row in store.domains.labelled("z")] == ["cafe", "office"]
    assert store.domains.labelled("other") == []


def test_a_change_that_is_refused_changes_nothing(store: Store, hospital: ForeignDomain) -> None:
    store.domains.accept(hospital, NOW)
    with pytest.raises(StoreError, match="has another root key"):
        store.domains.accept(foreign(Site.create("hospital.example")), NOW)
    with pytest.raises(StoreError, match="is that of domain hospital"):
        store.domains.accept(foreign(Site.create("cafe"), "hospital"), NOW)
    with pytest.raises(StoreError, match="is called hospital here"):
        store.domains.accept(dataclasses.replace(hospital, label="clinic"), NOW)
    assert [row.read() for row in store.domains.all()] == [hospital]


@pytest.mark.parametrize(
    ("found", "message"),
    [
        (("a", "x", b"k"), None),
        (("b", "y", b"j"), None),
        (("a", "x", b"j"), "another root key"),
        (("a", "y", b"k"), "domain a is called x here"),
        (("b", "x", b"j"), "the label x is that of domain a"),
        (("b", "y", b"k"), "domain a has the same root key"),
        (("b", "x", b"k"), "the label x is that of domain a"),
        (("a", "y", b"j"), "another root key"),
    ],
)
def test_two_domains_share_nothing(found: tuple[str, str, bytes], message: str | None) -> None:
    known = DomainRow(1, "a", "x", b"k", b"", NOW)
    if message is None:
        check_domains_apart(known, *found)
        return
    with pytest.raises(StoreError, match=message) as caught:
        check_domains_apart(known, *found)
    assert caught.value.hint


def test_lists_are_numbered_and_the_newest_is_found(store: Store) -> None:
    assert store.domains.newest_list() == b""
    assert store.domains.next_number() == (1, 1)
    store.domains.save_list((1, 1), b"one", NOW)
    assert store.domains.next_number() == (1, 2)
    store.domains.save_list((NOW, 1), b"new epoch", NOW)
    store.domains.save_list((1, 2), b"two", NOW)
    assert store.domains.newest_list() == b"new epoch"
    assert store.domains.next_number() == (NOW, 2)
    with pytest.raises(StoreError, match="refuses the entry"):
        store.domains.save_list((1, 2), b"another", NOW)


def test_certificates_of_foreign_nodes_are_recorded_once(store: Store) -> None:
    site = Site.create("hospital.example")
    root, robot = site.anchor.thumbprint, SomeNode(site, "/rounds/robot3").identity
    for _ in range(2):
        store.domains.add_certificate(root, robot, NOW)
    (row,) = store.domains.certificates(root)
    assert row == (robot.thumbprint, root, "/rounds/robot3", robot.certificate, NOW)
    assert store.domains.certificates(b"other") == []
    assert [entry.what for entry in store.log.entries()] == ["foreign certificate"]
