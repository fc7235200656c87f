"""Who is believed: the own authority, and listed ones for the names that are admitted."""

from typing import Any

import pytest

from ca.authority import Authority
from ca.certificates import Identity, build_intermediate_request
from ca.domains import Anchors
from ca.errors import CertificateExpired, CertificateRefused, DomainsRefused, ForeignCertificate, NotAdmitted
from ca.keys.signing import KeySigner, to_coordinates
from ca.svid import build_request
from tests.support.domains import domains, foreign
from tests.support.pki import DAY, NOW, Draft, Site, draft_leaf, leaf_extensions, new_signer


class World:
    """A home, two other domains, and what the home's nodes believe."""

    def __init__(self) -> None:
        self.home, self.hospital = Site.create("home"), Site.create("hospital.example")
        self.cafe = Site.create("cafe")
        self.anchors = Anchors(self.home.anchor)

    def list(self, *entries: Any, **options: Any) -> frozenset[str]:
        """Take a new list."""
        return self.anchors.update(domains(self.home, *entries, **options))

    def accept(self, seq: int = 1, **changes: Any) -> frozenset[str]:
        """Take a list that names the hospital."""
        return self.list(foreign(self.hospital, **changes), seq=seq)

    def verify(self, leaf: bytes, now: int = NOW) -> Identity:
        return self.anchors.verify([leaf], now)


@pytest.fixture
def world() -> World:
    return World()


def test_a_foreigner_is_its_alias(world: World) -> None:
    world.accept()
    leaf = world.hospital.leaf("/rounds/robot3")
    found = world.verify(leaf)
    assert found.name == "/remote/hospital/rounds/robot3"
    assert (found.domain, found.certified_name) == ("hospital.example", "/rounds/robot3")
    assert found.is_foreign
    assert found.covers("/rounds/robot3")
    assert not found.covers(found.name)
    own = world.verify(world.home.leaf("/rounds/robot3"))
    assert (own.name, own.is_foreign) == ("/rounds/robot3", False)


@pytest.mark.parametrize("name", ["/master", "/ca", "/robot"])
def test_a_foreign_name_equals_none_of_the_own(world: World, name: str) -> None:
    world.accept(admitted=("/**",))
    found = world.verify(world.hospital.leaf(name))
    assert found.name == f"/remote/hospital{name}" != name


def test_without_a_list_there_is_no_foreigner(world: World) -> None:
    with pytest.raises(ForeignCertificate):
        world.verify(world.hospital.leaf("/rounds/a"))
    assert world.anchors.data == b""
    assert (world.anchors.current, world.anchors.all_listed) == (None, ())
    assert world.anchors.ended(NOW) == frozenset()


def test_a_domain_that_is_not_listed(world: World) -> None:
    world.accept()
    with pytest.raises(ForeignCertificate):
        world.verify(world.cafe.leaf("/rounds/a"))


def test_a_name_that_is_not_admitted(world: World) -> None:
    world.accept()
    for name in ("/rounds", "/rounds/a/b", "/ca", "/roundsx/a"):
        with pytest.raises(NotAdmitted, match=f"hospital:{name} is not admitted here") as caught:
            world.verify(world.hospital.leaf(name))
        assert "rossec domain" in caught.value.hint


def test_trust_ends_with_its_time(world: World) -> None:
    end = NOW + 100
    world.accept(until=end)
    leaf = world.hospital.leaf("/rounds/a")
    assert world.verify(leaf, end - 1).not_after == end - 1
    with pytest.raises(NotAdmitted, match="has ended"):
        world.verify(leaf, end)
    assert world.anchors.ended(end - 1) == frozenset()
    assert world.anchors.ended(end) == {"hospital.example"}


def test_a_list_that_has_expired_admits_nobody_and_cuts_nobody(world: World) -> None:
    world.list(foreign(world.hospital, until=NOW + 50 * DAY), life=DAY)
    leaf = world.hospital.leaf("/rounds/a")
    world.verify(leaf, NOW + DAY - 1)
    with pytest.raises(NotAdmitted, match="the list of domains has expired"):
        world.verify(leaf, NOW + DAY)
    assert world.anchors.ended(NOW + DAY) == frozenset()
    assert world.verify(world.home.leaf("/a"), NOW + DAY).name == "/a"


def test_a_leaf_whose_name_says_another_domain(world: World) -> None:
    """The domain in a leaf selects the root; the root's own domain must be in it as well."""
    world.list(foreign(world.cafe, "cafe"), foreign(world.hospital))
    lying = draft_leaf(world.cafe, leaf_extensions("spiffe://hospital.example/rounds/a")).build()
    with pytest.raises(ForeignCertificate):
        world.verify(lying)
    home = draft_leaf(world.hospital, leaf_extensions("spiffe://home/robot")).build()
    with pytest.raises(ForeignCertificate):
        world.verify(home)


def test_a_home_identity_is_no_foreign_one(world: World) -> None:
    """Signed by the own key, but for the other domain."""
    world.accept()
    made = draft_leaf(world.home, leaf_extensions("spiffe://hospital.example/rounds/a")).build()
    with pytest.raises(ForeignCertificate):
        world.verify(made)


def test_a_leaf_that_was_changed_or_is_none(world: World) -> None:
    world.accept()
    leaf = world.hospital.leaf("/rounds/a")
    for chain in ([], [leaf[:-1]], [leaf, leaf, leaf], [b""], [leaf[:-1] + bytes([leaf[-1] ^ 1])]):
        with pytest.raises(CertificateRefused):
            world.anchors.verify(chain, NOW)
    until = NOW + 90 * DAY
    world.list(foreign(world.hospital, until=until), seq=2, life=90 * DAY)
    with pytest.raises(CertificateExpired):
        world.verify(leaf, NOW + 40 * DAY)


def test_a_name_that_has_no_alias_here(world: World) -> None:
    world.accept(admitted=("/**",))
    long = "/" + "a" * 250
    with pytest.raises(NotAdmitted, match="no alias here"):
        world.verify(world.hospital.leaf(long))


def test_an_intermediate_of_a_listed_domain(world: World) -> None:
    world.accept()
    key = new_signer()
    csr = build_intermediate_request(key, "hospital.example")
    ward = world.hospital.authority.issue_intermediate(csr, now=NOW, serial=5, may_enroll=True, lifetime=DAY)
    below = Authority(key, world.hospital.root, ward)
    leaf = below.issue(build_request(new_signer(), "hospital.example", "/rounds/b"), now=NOW, serial=6)
    found = world.anchors.verify([leaf, ward], NOW)
    assert found.name == "/remote/hospital/rounds/b"
    assert len(found.issuers) == 1


def test_what_a_list_says_is_looked_up(world: World) -> None:
    key = to_coordinates(new_signer().public_key)
    world.list(foreign(world.hospital), foreign(world.cafe, "bar"), masters=(key,))
    by_label, by_domain = world.anchors.listed("bar"), world.anchors.listed_domain("cafe")
    assert by_label is not None
    assert by_label is by_domain
    assert by_label.entry.label == "bar"
    assert by_label.anchor.domain == "cafe"
    assert world.anchors.listed("cafe") is world.anchors.listed_domain("bar") is None
    assert [each.entry.domain for each in world.anchors.all_listed] == ["cafe", "hospital.example"]
    assert [to_coordinates(each) for each in world.anchors.masters] == [key]


def test_a_new_list_says_whose_connections_end(world: World) -> None:
    entries = [foreign(world.hospital), foreign(world.cafe, "cafe")]
    assert world.list(*entries) == frozenset()
    assert world.list(*entries, seq=2) == frozenset()
    wider = foreign(world.hospital, until=NOW + DAY, fresh=60, exported=(("/a", 2),))
    assert world.list(wider, entries[1], seq=3) == frozenset()
    assert world.list(foreign(world.hospital, admitted=("/a",)), entries[1], seq=4) == {"hospital.example"}
    assert world.list(foreign(world.hospital, "clinic"), entries[1], seq=5) == {"hospital.example"}
    assert world.list(entries[1], seq=6) == {"hospital.example"}
    again = foreign(Site.create("cafe"), "cafe")  # the same name, another key
    assert world.list(again, seq=7) == {"cafe"}
    assert world.list(seq=8) == {"cafe"}


def test_an_older_list_and_a_second_one_of_a_number_are_refused(world: World) -> None:
    old, new = domains(world.home, seq=1), domains(world.home, foreign(world.hospital), seq=2)
    taken: list[bytes] = []
    world.anchors.update(new, taken.append)
    assert world.anchors.update(new, taken.append) == frozenset()
    with pytest.raises(DomainsRefused, match="older"):
        world.anchors.update(old, taken.append)
    with pytest.raises(DomainsRefused, match="two different lists"):
        world.anchors.update(domains(world.home, seq=2), taken.append)
    assert taken == [new]
    assert world.anchors.data == new
    floored = Anchors(world.home.anchor, (1, 3))
    with pytest.raises(DomainsRefused, match="older"):
        floored.update(new)


def test_a_list_that_cannot_be_kept_has_no_effect(world: World) -> None:
    def fails(_: bytes) -> None:
        raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        world.anchors.update(domains(world.home, foreign(world.hospital)), fails)
    assert world.anchors.current is None
    with pytest.raises(ForeignCertificate):
        world.verify(world.hospital.leaf("/rounds/a"))
    world.accept()


def test_a_list_of_another_authority_is_refused(world: World) -> None:
    with pytest.raises(DomainsRefused, match="not a list of domains of this authority"):
        world.anchors.update(domains(world.hospital, foreign(world.cafe, "cafe")))


def test_a_leaf_without_a_name_is_tried_with_the_own_root(world: World) -> None:
    world.accept()
    nameless: Draft = draft_leaf(world.hospital, leaf_extensions()[:2])
    with pytest.raises(CertificateRefused):
        world.verify(nameless.build())
    assert KeySigner(world.home.key).public_key == world.anchors.own.public_key
