"""What the master knows of other domains: the list, their revocations, and what it relays."""

from dataclasses import replace
from typing import Any

import pytest

from ca.certificates import Identity
from ca.domains import Anchors
from ca.errors import DomainsRefused, NotAdmitted, RevocationRefused, RevocationsStale, Revoked
from ca.keys.signing import to_coordinates
from ca.revocation.lists import digest
from ca.revocation.trust_status import Revocations, TrustStatus
from grants.errors import GrantForged
from grants.model import ALL_RIGHTS, Right
from rossec.errors import NotWritten
from rossec.master.rights.caller import OWN_DOMAIN
from rossec.master.rights.domain_trust import GRACE, DomainTrust
from tests.support.domains import SomeNode, domains, foreign, revoked, revoked_tree
from tests.support.pki import DAY, NOW, Site

DOMAIN = "hospital.example"


class Master:
    """A home's master that has listed a hospital, which has revoked nothing."""

    def __init__(self) -> None:
        self.home, self.hospital = Site.create("home"), Site.create(DOMAIN)
        self.saved: list[Any] = []
        self.trust_status = TrustStatus(Anchors(self.home.anchor), Revocations(self.home.anchor.public_key))
        self.trust = DomainTrust(self.trust_status, self.saved.append, lambda *both: self.saved.append(both))
        self.list = domains(self.home, foreign(self.hospital))
        self.trust.update(self.list)
        self.speaker = SomeNode(self.hospital, "/master")
        self.robot = SomeNode(self.hospital, "/rounds/robot3")
        self.data = revoked(self.hospital)
        self.take(self.data)

    def take(self, data: bytes, seq: int = 1, now: int = NOW) -> None:
        stamp = self.speaker.stamp(data, seq, issued=now)
        self.trust.take(DOMAIN, data, stamp, [self.speaker.leaf], now)

    def peer(self, member: SomeNode | None = None) -> Identity:
        return self.trust.anchors.verify(((member or self.robot).leaf,), NOW)


@pytest.fixture
def master() -> Master:
    return Master()


def test_lists_are_saved_before_they_take_effect(master: Master) -> None:
    assert master.saved == [master.list, (DOMAIN, master.data)]


def test_a_list_that_cannot_be_saved_changes_nothing(master: Master) -> None:
    def full(*_: object) -> None:
        raise NotWritten("the disk is full")

    trust = DomainTrust(master.trust_status, full, full)
    generation = trust.generation
    with pytest.raises(NotWritten):
        trust.update(domains(master.home, seq=2))
    assert trust.anchors.data == master.list
    with pytest.raises(NotWritten):
        trust.take(DOMAIN, revoked(master.hospital, seq=2), b"", [], NOW)
    assert trust.generation == generation
    assert trust.word(DOMAIN).revocations == master.data


def test_a_newer_list_of_domains_counts_once(master: Master) -> None:
    generation, newer = master.trust.generation, domains(master.home, seq=2)
    assert master.trust.update(newer) == frozenset({DOMAIN})
    assert master.trust.update(newer) is None
    assert master.trust.generation == generation + 1
    assert master.trust.number == 2
    assert master.trust.digest() == digest(newer)
    with pytest.raises(DomainsRefused, match="older"):
        master.trust.update(master.list)


def test_without_a_list_there_is_no_number_and_no_digest(master: Master) -> None:
    empty = DomainTrust(TrustStatus(Anchors(master.home.anchor), master.trust_status.own))
    assert (empty.number, empty.digest(), empty.next_end(NOW)) == (0, b"", None)
    assert empty.update(master.list) == frozenset()


def test_the_word_of_a_foreign_master_is_relayed(master: Master) -> None:
    word = master.trust.word(DOMAIN)
    assert word.revocations == master.data
    assert word.chain == (master.speaker.leaf,)
    assert word.digest() == digest(master.data)
    other = TrustStatus(Anchors(master.home.anchor), master.trust_status.own)
    other.anchors.update(master.list)
    other.take_foreign(DOMAIN, *word, NOW)
    other.check(DOMAIN, b"x" * 32, NOW)


def test_a_list_whose_timestamp_is_refused_is_in_force_and_not_confirmed(master: Master) -> None:
    newer = revoked(master.hospital, master.robot.identity.thumbprint, seq=2)
    generation = master.trust.generation
    with pytest.raises(RevocationsStale):
        master.trust.take(DOMAIN, newer, b"", [], NOW)
    assert master.trust.generation == generation + 1
    assert master.trust.word(DOMAIN) == (newer, b"", ())
    with pytest.raises(Revoked):
        master.trust.check_connected(master.peer(), NOW)


def test_an_older_list_of_another_domain_is_refused(master: Master) -> None:
    master.take(revoked(master.hospital, seq=2), 2)
    generation = master.trust.generation
    with pytest.raises(RevocationRefused, match="is older than"):
        master.take(master.data)
    assert master.trust.generation == generation


def test_of_a_domain_that_is_gone_nothing_is_relayed(master: Master) -> None:
    master.trust.update(domains(master.home, seq=2))
    assert master.trust.word(DOMAIN) == (b"", b"", ())
    assert master.trust.word(DOMAIN).digest() == b""
    with pytest.raises(NotAdmitted):
        master.trust.take(DOMAIN, master.data, b"", [], NOW)


def test_a_saved_list_is_restored_unconfirmed(master: Master) -> None:
    saved = {DOMAIN: revoked(master.hospital, master.robot.identity.thumbprint, seq=2)}
    trust_status = TrustStatus(Anchors(master.home.anchor), master.trust_status.own)
    other = DomainTrust(trust_status, load_foreign=saved.get)
    other.update(master.list)
    with pytest.raises(Revoked):
        other.check_connected(master.peer(), NOW)
    with pytest.raises(RevocationsStale):
        other.check_fresh(master.peer(master.speaker), NOW)
    with pytest.raises(RevocationRefused, match="is older than"):
        other.take(DOMAIN, master.data, b"", [], NOW)


def test_a_foreigner_connects_while_its_domains_revocations_are_fresh(master: Master) -> None:
    peer = master.peer()
    master.trust.admit(peer, NOW + 3600)
    with pytest.raises(RevocationsStale):
        master.trust.admit(peer, NOW + 3601)


def test_a_foreign_master_connects_while_its_domains_revocations_are_stale(master: Master) -> None:
    """Else two masters that know nothing of each other would wait for each other."""
    peer, stale = master.peer(master.speaker), NOW + 3601
    master.trust.admit(peer, stale)
    master.trust.check_connected(peer, stale + GRACE)
    master.trust.check_for(peer, b"g" * 16, NOW)
    with pytest.raises(RevocationsStale):
        master.trust.check_for(peer, b"g" * 16, stale)


def test_a_connection_stands_a_minute_longer(master: Master) -> None:
    peer, stale = master.peer(), NOW + 3601
    master.trust.check_connected(peer, stale)
    master.trust.check_connected(peer, stale + GRACE - 1)
    with pytest.raises(RevocationsStale):
        master.trust.check_connected(peer, stale + GRACE)
    stamp = master.speaker.stamp(master.data, issued=stale + GRACE)
    master.trust.take(DOMAIN, b"", stamp, [master.speaker.leaf], stale + GRACE)
    master.trust.check_connected(peer, stale + GRACE)
    master.trust.check_connected(peer, stale + GRACE + 3601)  # it begins anew


def test_what_is_known_of_keys_that_are_gone_is_discarded(master: Master) -> None:
    peer, stale = master.peer(), NOW + 3601
    master.trust.check_connected(peer, stale)
    master.trust.keep_only(frozenset({peer.thumbprint}))
    with pytest.raises(RevocationsStale):
        master.trust.check_connected(peer, stale + GRACE)
    master.trust.keep_only(frozenset())
    master.trust.check_connected(peer, stale + GRACE)


def test_staleness_does_not_count_for_grants_and_revocation_does(master: Master) -> None:
    entry = b"g" * 16
    master.trust.check_known(DOMAIN, entry, NOW + DAY)
    master.take(revoked(master.hospital, entry, seq=2), 2)
    with pytest.raises(Revoked):
        master.trust.check_known(DOMAIN, entry, NOW)
    with pytest.raises(NotAdmitted):
        master.trust.check_known("clinic.example", entry, NOW)


def test_labels_of_foreign_domains_and_of_own_sites(master: Master) -> None:
    master.trust.own_sites = lambda: {"kitchen"}
    assert master.trust.domain_of("hospital") == DOMAIN
    assert master.trust.domain_of("kitchen") == OWN_DOMAIN
    assert master.trust.domain_of("clinic") is None
    assert master.trust.label_of(DOMAIN) == "hospital"
    assert master.trust.label_of("home") == ""


def test_the_label_of_a_domain_is_not_that_of_an_own_site(master: Master) -> None:
    master.trust.own_sites = lambda: {"hospital"}
    assert master.trust.domain_of("hospital") == DOMAIN


@pytest.mark.parametrize(
    ("name", "expected"),
    [("/master", True), ("/master/kitchen", True), ("/master/a/b", False), ("/robot", False)],
)
def test_own_masters_are_listed_and_named_so(master: Master, name: str, expected: bool) -> None:
    found = SomeNode(master.home, name)
    assert not master.trust.is_own_master(found.identity)
    master.trust.update(domains(master.home, seq=2, masters=(to_key(found),)))
    assert master.trust.is_own_master(found.identity) == expected


def test_a_foreigner_with_the_key_of_an_own_master_is_none(master: Master) -> None:
    found = SomeNode(master.home, "/master")
    listed = domains(master.home, foreign(master.hospital), seq=2, masters=(to_key(found),))
    master.trust.update(listed)
    alias = replace(found.identity, name="/master", certified="/master")
    assert not master.trust.is_own_master(alias)
    assert not master.trust.is_own_master(replace(found.identity, wildcard=True))
    [delegate] = master.trust.own_delegates()
    assert delegate.public_numbers() == found.key.public_numbers()


def test_exports_bound_a_domain(master: Master) -> None:
    assert master.trust.exported(DOMAIN) is None
    entry = foreign(master.hospital, exported=(("/robot/**", 2),))
    master.trust.update(domains(master.home, entry, seq=2))
    found = master.trust.exported(DOMAIN)
    assert found is not None
    assert found.covers(Right.SUBSCRIBE, "/robot/pose")
    assert not found.covers(Right.PUBLISH, "/robot/pose")
    nothing = foreign(master.hospital, exported=())
    master.trust.update(domains(master.home, nothing, seq=3))
    found = master.trust.exported(DOMAIN)
    assert found is not None
    assert not found.covers(Right.SUBSCRIBE, "/robot/pose")


def test_what_is_taken_from_a_domain_is_asked_by_its_label(master: Master) -> None:
    assert master.trust.imported("hospital") is None
    entry = foreign(master.hospital, imported=(("/robot/**", 2),))
    master.trust.update(domains(master.home, entry, seq=2))
    found = master.trust.imported("hospital")
    assert found is not None
    assert found.covers(Right.SUBSCRIBE, "/robot/pose")
    assert not found.covers(Right.CALL, "/robot/pose")
    master.trust.update(domains(master.home, seq=3))
    found = master.trust.imported("hospital")
    assert found is not None, "of a domain that is not listed nothing is taken"
    assert not found.covers_any(ALL_RIGHTS, "/robot/pose")


def test_grants_of_a_domain_are_opened_with_its_key(master: Master) -> None:
    verifier = master.trust.verifier(DOMAIN)
    assert verifier.ca_key.public_numbers() == master.hospital.anchor.public_key.public_numbers()
    assert verifier.domain == DOMAIN
    assert [key.public_numbers() for key in verifier.delegates] == [master.speaker.key.public_numbers()]
    with pytest.raises(NotAdmitted):
        master.trust.verifier("clinic.example")


def test_a_verifier_refuses_what_is_not_a_grant(master: Master) -> None:
    with pytest.raises(GrantForged):
        master.trust.verifier(DOMAIN).open(b"garbage", NOW)


def test_the_next_end_of_a_trust(master: Master) -> None:
    entry = foreign(master.hospital, until=NOW + 100)
    master.trust.update(domains(master.home, entry, seq=2))
    assert master.trust.next_end(NOW) == NOW + 100
    assert master.trust.next_end(NOW + 100) is None


def test_proofs_of_a_foreign_tree_are_fetched_by_need(master: Master) -> None:
    assert master.trust.proofs(DOMAIN, [b"e" * 16]) == []  # a list needs none
    gone, here = b"a" * 16, b"e" * 16
    data, entries = revoked_tree(master.hospital, gone, seq=2)
    with pytest.raises(RevocationsStale):
        master.take(data, 2)
    key = master.speaker.identity.thumbprint
    assert key in master.trust.wanted_proofs(DOMAIN)
    master.trust.add_proof(DOMAIN, key, entries.prove(key))
    stamp = master.speaker.stamp(data, 2)
    master.trust.take(DOMAIN, b"", stamp, [master.speaker.leaf], NOW)
    assert master.trust.proofs(DOMAIN, [gone, here]) == [b"", b""]
    assert {gone, here} <= set(master.trust.wanted_proofs(DOMAIN))
    wanted = master.trust.wanted_proofs(DOMAIN)
    assert master.trust.proofs(DOMAIN, [b"", b"x" * 600_000]) == [b"", b""]
    assert master.trust.wanted_proofs(DOMAIN) == wanted, "no tree has such entries"
    generation = master.trust.generation
    master.trust.add_proof(DOMAIN, here, entries.prove(here))
    assert master.trust.generation == generation
    master.trust.add_proof(DOMAIN, gone, entries.prove(gone))
    assert master.trust.generation == generation + 1
    assert master.trust.proofs(DOMAIN, [gone, here]) == [entries.prove(gone), entries.prove(here)]
    assert here not in master.trust.wanted_proofs(DOMAIN)
    with pytest.raises(Revoked):
        master.trust.check_known(DOMAIN, gone, NOW)
    with pytest.raises(RevocationRefused):
        master.trust.add_proof(DOMAIN, b"x" * 16, b"garbage")
    with pytest.raises(RevocationRefused, match="no such tree"):
        master.trust.add_proof("clinic.example", here, entries.prove(here))


def to_key(member: SomeNode) -> bytes:
    return to_coordinates(member.key)
