from typing import Any

import pytest

from ca.domains import Anchors
from ca.errors import (
    CertificateRefused,
    ClocksDisagree,
    NotAdmitted,
    RevocationRefused,
    RevocationsStale,
    Revoked,
)
from ca.keys.signing import thumbprint, to_coordinates
from ca.revocation.trust_status import MAX_DELEGATES, SKEW, Revocations, TrustStatus
from tests.support.domains import Pair, SomeNode, domains, foreign, revoked, revoked_tree
from tests.support.pki import DAY, NOW, Site

A, B = b"a" * 16, b"b" * 16
DOMAIN = "hospital.example"


@pytest.fixture
def pair() -> Pair:
    pair = Pair()
    pair.confirm_own()
    return pair


def take(pair: Pair, data: bytes, stamp: bytes, *chain: bytes, now: int = NOW) -> frozenset[bytes]:
    return pair.trust_status.take_foreign(DOMAIN, data, stamp, chain or [pair.master.leaf], now)


def test_a_foreigner_counts_after_its_masters_word(pair: Pair) -> None:
    peer = pair.peer()
    with pytest.raises(RevocationsStale, match="of domain hospital: no revocation list") as caught:
        pair.trust_status.check_peer(peer, NOW)
    assert "rossec federation status" in caught.value.hint
    assert pair.confirm_foreign() == frozenset()
    pair.trust_status.check_peer(peer, NOW)


def test_a_foreign_list_ages_by_fresh_and_not_by_the_timestamps_word(pair: Pair) -> None:
    pair.confirm_foreign()
    found = pair.trust_status.foreign(DOMAIN)
    assert found is not None
    assert found.fresh_until == NOW + 3600
    pair.trust_status.check(DOMAIN, A, NOW + 3600)
    with pytest.raises(RevocationsStale, match="the last confirmation expired 1 s ago"):
        pair.trust_status.check(DOMAIN, A, NOW + 3601)
    pair.anchors.update(domains(pair.home, foreign(pair.hospital, fresh=60), seq=2))
    assert pair.trust_status.status_valid_until(DOMAIN, A) == NOW + 60


def test_an_old_timestamp_within_fresh_counts_after_a_restart(pair: Pair) -> None:
    data = revoked(pair.hospital)
    take(pair, data, pair.master.stamp(data), now=NOW + 3000)
    pair.trust_status.check(DOMAIN, A, NOW + 3000)
    other = Pair()
    data = revoked(other.hospital)
    with pytest.raises(ClocksDisagree, match="too old"):
        take(other, data, other.master.stamp(data), now=NOW + 3601)
    with pytest.raises(ClocksDisagree, match="future"):
        take(other, data, other.master.stamp(data, issued=NOW + SKEW + 1))


def test_the_hospital_revokes_its_robot_and_the_home_does(pair: Pair) -> None:
    peer = pair.peer()
    assert pair.confirm_foreign(peer.thumbprint) == {peer.thumbprint}
    with pytest.raises(Revoked):
        pair.trust_status.check_peer(peer, NOW)
    assert pair.trust_status.revoked(DOMAIN) == {peer.thumbprint}

    other = Pair()
    other.confirm_foreign()
    other.confirm_own(other.peer().thumbprint)
    with pytest.raises(Revoked):
        other.trust_status.check_peer(other.peer(), NOW)


def test_a_hospital_revokes_nothing_of_the_home(pair: Pair) -> None:
    own = pair.own_master.identity
    pair.confirm_foreign(A, own.thumbprint)
    pair.trust_status.check("home", A, NOW)
    pair.trust_status.check_peer(own, NOW)


def test_the_own_list_is_checked_for_a_foreigner_too() -> None:
    pair = Pair()
    pair.confirm_foreign()
    with pytest.raises(RevocationsStale, match="no revocation list was received yet"):
        pair.trust_status.check_peer(pair.peer(), NOW)


def test_a_revoked_intermediate_is_found_behind_stale_data() -> None:
    pair = Pair()
    data = revoked(pair.hospital, b"i" * 32)
    with pytest.raises(RevocationsStale):
        take(pair, data, b"")
    peer = pair.peer()
    object.__setattr__(peer, "issuers", (b"i" * 32,))
    with pytest.raises(Revoked):
        pair.trust_status.check_peer(peer, NOW)


def test_a_list_without_a_word_revokes_and_confirms_nothing(pair: Pair) -> None:
    with pytest.raises(RevocationsStale, match="no word of hospital's master"):
        take(pair, revoked(pair.hospital, A), b"")
    with pytest.raises(Revoked):
        pair.trust_status.check(DOMAIN, A, NOW)
    with pytest.raises(RevocationsStale):
        pair.trust_status.check(DOMAIN, B, NOW)


def test_an_empty_list_is_the_one_held(pair: Pair) -> None:
    data = revoked(pair.hospital)
    take(pair, data, pair.master.stamp(data))
    take(pair, b"", pair.master.stamp(data, issued=NOW + 100), now=NOW + 100)
    assert pair.trust_status.status_valid_until(DOMAIN, A) == NOW + 3700


def test_an_old_foreign_list_is_refused(pair: Pair) -> None:
    old = revoked(pair.hospital)
    pair.confirm_foreign(A, seq=2)
    with pytest.raises(RevocationRefused, match=r"1\.1 is older than 1\.2"):
        take(pair, old, pair.master.stamp(old))
    with pytest.raises(RevocationRefused, match="for another list"):
        take(pair, b"", pair.master.stamp(old))
    with pytest.raises(Revoked):
        pair.trust_status.check(DOMAIN, A, NOW)


def test_a_list_of_another_authority_is_refused(pair: Pair) -> None:
    for site in (pair.home, Site.create(DOMAIN)):
        data = revoked(site)
        with pytest.raises(RevocationRefused, match="is refused"):
            take(pair, data, pair.master.stamp(data))


def test_what_is_refused_is_not_persisted(pair: Pair) -> None:
    kept: list[bytes] = []
    data, domain = revoked(pair.hospital), DOMAIN
    stamp, chain = pair.master.stamp(data), [pair.master.leaf]
    pair.trust_status.take_foreign(domain, data, stamp, chain, NOW, kept.append)
    with pytest.raises(RevocationRefused):
        pair.trust_status.take_foreign(domain, revoked(pair.home), stamp, chain, NOW, kept.append)
    assert kept == [data]

    def full(_: bytes) -> None:
        raise OSError("disk full")

    with pytest.raises(OSError, match="disk full"):
        pair.trust_status.take_foreign(domain, revoked(pair.hospital, A, seq=2), stamp, chain, NOW, full)
    pair.trust_status.check(DOMAIN, A, NOW)


def test_only_a_master_of_that_domain_confirms(pair: Pair) -> None:
    data = revoked(pair.hospital)
    own = pair.own_master
    with pytest.raises(CertificateRefused, match="not signed by the authority"):
        take(pair, data, own.stamp(data), own.leaf)
    robot = pair.robot
    with pytest.raises(NotAdmitted, match=r"hospital:/rounds/robot3 is no master"):
        take(pair, data, robot.stamp(data), robot.leaf)
    with pytest.raises(RevocationRefused, match="is refused"):
        take(pair, data, robot.stamp(data), pair.master.leaf)
    with pytest.raises(CertificateRefused):
        pair.trust_status.take_foreign(DOMAIN, data, pair.master.stamp(data), [], NOW)
    kitchen = SomeNode(pair.hospital, "/master/ward")
    take(pair, data, kitchen.stamp(data), kitchen.leaf)
    pair.trust_status.check(DOMAIN, A, NOW)


def test_a_revoked_master_confirms_nothing(pair: Pair) -> None:
    with pytest.raises(Revoked):
        pair.confirm_foreign(pair.master.identity.thumbprint)
    with pytest.raises(RevocationsStale):
        pair.trust_status.check(DOMAIN, A, NOW)
    other = Pair()
    other.confirm_own(other.master.identity.thumbprint)
    with pytest.raises(Revoked):
        other.confirm_foreign()
    assert other.trust_status.delegates(DOMAIN) == ()


def test_an_unlisted_domain_has_no_list(pair: Pair) -> None:
    trust_status = pair.trust_status
    assert trust_status.foreign("elsewhere") is None
    assert trust_status.revoked("elsewhere") == frozenset()
    assert trust_status.delegates("elsewhere") == ()
    assert trust_status.status_valid_until("elsewhere", A) == 0
    assert not trust_status.restore("elsewhere", revoked(pair.hospital), NOW)
    with pytest.raises(NotAdmitted, match="domain 'elsewhere' is not listed here"):
        trust_status.check("elsewhere", A, NOW)
    with pytest.raises(NotAdmitted):
        trust_status.take_foreign("elsewhere", revoked(pair.hospital), b"", [], NOW)


def test_trust_ends_with_the_entry(pair: Pair) -> None:
    peer = pair.peer()
    pair.confirm_foreign()
    pair.trust_status.check_trust(peer, NOW + 10 * DAY - 1)
    with pytest.raises(NotAdmitted, match="the trust in domain hospital has ended"):
        pair.trust_status.check_trust(peer, NOW + 10 * DAY)
    pair.anchors.update(domains(pair.home, seq=2))
    for check in (pair.trust_status.check_trust, pair.trust_status.check_peer):
        with pytest.raises(NotAdmitted, match="is not listed here"):
            check(peer, NOW)


@pytest.mark.parametrize("changes", [{"admitted": ("/other/*",)}, {"label": "clinic"}])
def test_trust_ends_when_its_terms_change(pair: Pair, changes: dict[str, Any]) -> None:
    peer = pair.peer()
    pair.anchors.update(domains(pair.home, foreign(pair.hospital, **changes), seq=2))
    with pytest.raises(NotAdmitted, match=r":/rounds/robot3 is not admitted here any more"):
        pair.trust_status.check_trust(peer, NOW)


def test_another_root_begins_anew(pair: Pair) -> None:
    peer = pair.peer()
    pair.confirm_foreign(A, seq=7)
    new = Site.create(DOMAIN)
    pair.anchors.update(domains(pair.home, foreign(new), seq=2))
    with pytest.raises(NotAdmitted, match="has ended"):
        pair.trust_status.check_trust(peer, NOW)
    assert pair.trust_status.revoked(DOMAIN) == frozenset()
    assert pair.trust_status.delegates(DOMAIN) == ()
    assert not pair.trust_status.restore(DOMAIN, revoked(pair.hospital, A), NOW)
    assert pair.trust_status.restore(DOMAIN, revoked(new, B), NOW)
    assert pair.trust_status.revoked(DOMAIN) == {B}


def test_an_expired_list_of_domains_admits_nobody_and_cuts_nobody() -> None:
    pair = Pair()
    later = NOW + 5
    anchors = Anchors(pair.home.anchor)
    anchors.update(domains(pair.home, foreign(pair.hospital), life=5))
    trust_status = TrustStatus(anchors, pair.own)
    peer = anchors.verify((pair.robot.leaf,), NOW)
    with pytest.raises(NotAdmitted, match="the list of domains has expired"):
        trust_status.check_peer(peer, later)
    trust_status.check_trust(peer, later)


def test_tickets_count_from_masters_that_are_known_and_not_revoked(pair: Pair) -> None:
    kitchen = SomeNode(pair.home, "/master/kitchen")
    own = (to_coordinates(kitchen.key),)
    pair.anchors.update(domains(pair.home, foreign(pair.hospital), seq=2, masters=own))
    assert [thumbprint(key) for key in pair.trust_status.delegates("home")] == [kitchen.identity.thumbprint]
    assert pair.trust_status.delegates(DOMAIN) == ()
    pair.confirm_foreign()
    assert [thumbprint(key) for key in pair.trust_status.delegates(DOMAIN)] == [
        pair.master.identity.thumbprint
    ]
    pair.confirm_own(kitchen.identity.thumbprint, pair.master.identity.thumbprint, seq=2)
    assert pair.trust_status.delegates("home") == pair.trust_status.delegates(DOMAIN) == ()


def test_the_last_masters_of_a_domain_are_remembered(pair: Pair) -> None:
    data = revoked(pair.hospital)
    seen = [SomeNode(pair.hospital, f"/master/m{number}") for number in range(MAX_DELEGATES + 1)]
    for master in seen:
        take(pair, data, master.stamp(data), master.leaf)
    assert [thumbprint(key) for key in pair.trust_status.delegates(DOMAIN)] == [
        master.identity.thumbprint for master in seen[1:]
    ]


def test_a_foreign_tree_needs_proofs(pair: Pair) -> None:
    data, leaves = revoked_tree(pair.hospital, A, b"k" * 32)
    with pytest.raises(RevocationsStale, match="no proof yet for a foreign master's key"):
        take(pair, data, pair.master.stamp(data))
    found = pair.trust_status.foreign(DOMAIN)
    assert found is not None
    key = pair.master.identity.thumbprint
    assert found.unproved == [key]
    found.add_proof(key, leaves.prove(key))
    take(pair, b"", pair.master.stamp(data))
    with pytest.raises(RevocationsStale, match="no proof received yet"):
        pair.trust_status.check(DOMAIN, A, NOW)
    found.add_proof(A, leaves.prove(A))
    with pytest.raises(Revoked):
        pair.trust_status.check(DOMAIN, A, NOW)


def test_a_tree_that_holds_the_masters_key_is_not_confirmed_by_it(pair: Pair) -> None:
    key = pair.master.identity.thumbprint
    data, leaves = revoked_tree(pair.hospital, A, key)
    with pytest.raises(RevocationsStale):
        take(pair, data, pair.master.stamp(data))
    found = pair.trust_status.foreign(DOMAIN)
    assert found is not None
    found.add_proof(key, leaves.prove(key))
    with pytest.raises(Revoked):
        take(pair, b"", pair.master.stamp(data))


def test_a_clock_set_back_ends_every_confirmation(pair: Pair) -> None:
    pair.confirm_foreign()
    pair.trust_status.expire_confirmations(NOW - 1)
    for domain in ("home", DOMAIN):
        assert pair.trust_status.status_valid_until(domain, A) == NOW - 1
        with pytest.raises(RevocationsStale, match="not confirmed"):
            pair.trust_status.check(domain, A, NOW)


def test_without_a_list_nothing_is_foreign() -> None:
    home = Site.create("home")
    trust_status = TrustStatus(Anchors(home.anchor), Revocations(home.anchor.public_key))
    member = SomeNode(home, "/robot").identity
    trust_status.check_trust(member, NOW)
    with pytest.raises(RevocationsStale):
        trust_status.check_peer(member, NOW)
    assert trust_status.delegates("home") == ()
