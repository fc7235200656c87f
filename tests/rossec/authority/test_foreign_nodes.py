"""Foreign nodes as holders of grants: by a certificate below the listed root, and by the record."""

from collections.abc import Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from ca.certificates import to_pem
from ca.errors import CertificateRefused, DomainUnknown, NotAdmitted
from ca.store.record import Store
from rossec.authority import domain_operations
from rossec.errors import ConfigurationError
from tests.support.domains import SomeNode, foreign
from tests.support.pki import DAY, NOW, Site

ROBOT = "/remote/hospital/rounds/robot3"


@pytest.fixture
def hospital() -> Site:
    return Site.create("hospital.example")


@pytest.fixture
def store(tmp_path: Path, hospital: Site) -> Iterator[Store]:
    with closing(Store.create(tmp_path / "ca.db")) as made:
        made.domains.accept(foreign(hospital), NOW)
        yield made


def pem(site: Site, node: SomeNode) -> bytes:
    return to_pem(node.leaf, site.root)


def test_a_certificate_below_the_listed_root_names_a_key(store: Store, hospital: Site) -> None:
    node = SomeNode(hospital, "/rounds/robot3")
    for data in (pem(hospital, node), to_pem(node.leaf)):
        identity, root = domain_operations.verify(store, ROBOT, data, NOW)
        assert (identity.name, identity.certified_name) == (ROBOT, "/rounds/robot3")
        assert (identity.thumbprint, root) == (node.identity.thumbprint, hospital.anchor.thumbprint)


def test_any_other_certificate_is_refused(store: Store, hospital: Site) -> None:
    node = SomeNode(hospital, "/rounds/robot3")
    with pytest.raises(ConfigurationError, match="hospital:/rounds/robot3") as refused:
        domain_operations.verify(store, "/remote/hospital/rounds/r7", pem(hospital, node), NOW)
    assert refused.value.hint == "name that node"
    other = SomeNode(hospital, "/kitchen")
    with pytest.raises(NotAdmitted):
        domain_operations.verify(store, "/remote/hospital/kitchen", pem(hospital, other), NOW)
    with pytest.raises(NotAdmitted):
        domain_operations.verify(store, ROBOT, pem(hospital, node), NOW + 11 * DAY)
    twin = Site.create("hospital.example")
    stolen = SomeNode(twin, "/rounds/robot3")
    with pytest.raises(CertificateRefused):
        domain_operations.verify(store, ROBOT, to_pem(stolen.leaf), NOW)
    with pytest.raises(DomainUnknown):
        domain_operations.verify(store, "/remote/clinic/a", pem(hospital, node), NOW)
    with pytest.raises(ConfigurationError, match="a node of this domain"):
        domain_operations.verify(store, "/rounds/robot3", pem(hospital, node), NOW)


def record(store: Store, site: Site, node: SomeNode) -> bytes:
    identity = replace(node.identity, name=ROBOT, certified=node.identity.name)
    store.domains.add_certificate(site.anchor.thumbprint, identity, NOW)
    return identity.thumbprint


def test_the_newest_recorded_certificate_counts(store: Store, hospital: Site) -> None:
    with pytest.raises(ConfigurationError, match="no valid certificate") as refused:
        domain_operations.holder(store, ROBOT, NOW)
    assert "--certificate" in refused.value.hint
    record(store, hospital, SomeNode(hospital, "/rounds/robot3"))
    newest = record(store, hospital, SomeNode(hospital, "/rounds/robot3"))
    record(store, hospital, SomeNode(hospital, "/kitchen"))
    assert domain_operations.holder(store, ROBOT, NOW) == newest
    assert [each.name for each in domain_operations.subjects(store, NOW)] == [ROBOT]
    for later in (NOW - 400 * DAY, NOW + 11 * DAY, NOW + 4000 * DAY):
        assert list(domain_operations.subjects(store, later)) == []


def test_without_trust_in_the_domain_nobody_is_known(store: Store, hospital: Site) -> None:
    record(store, hospital, SomeNode(hospital, "/rounds/robot3"))
    store.domains.end("hospital", "", NOW)
    assert list(domain_operations.subjects(store, NOW)) == []


def test_the_recorded_keys_are_revoked_once(store: Store, hospital: Site) -> None:
    root = hospital.anchor.thumbprint
    with pytest.raises(ConfigurationError, match="no certificate of hospital:/rounds") as refused:
        domain_operations.unrevoked_keys(store, root, ROBOT)
    assert "--certificate" in refused.value.hint
    keys = {record(store, hospital, SomeNode(hospital, "/rounds/robot3")) for _ in range(2)}
    record(store, hospital, SomeNode(hospital, "/kitchen"))
    assert domain_operations.unrevoked_keys(store, root, ROBOT) == keys
    store.revoke(min(keys), "", NOW)
    assert domain_operations.unrevoked_keys(store, root, ROBOT) == {max(keys)}
    store.revoke(max(keys), "", NOW)
    with pytest.raises(ConfigurationError, match="is revoked already") as refused:
        domain_operations.unrevoked_keys(store, root, ROBOT)
    assert "rossec ca publish" in refused.value.hint


def test_only_an_alias_is_split() -> None:
    assert domain_operations.split(ROBOT) == ("hospital", "/rounds/robot3")
    with pytest.raises(ConfigurationError, match="a node of this domain"):
        domain_operations.split("/rounds/robot3")
