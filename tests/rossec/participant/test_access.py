import time
from dataclasses import replace
from pathlib import Path

import pytest

from ca.encoding import Value, encode
from ca.errors import CAError, RevocationsStale, Revoked
from ca.revocation.lists import Timestamp, digest, sign_timestamp
from ca.revocation.trust_status import Revocations
from grants.errors import GrantExpired, GrantForged, GrantMalformed, GrantMissing, GrantNotHeld, GrantRevoked
from grants.model import Right
from rossec.participant import access
from rossec.participant.access import Access
from tests.support.domains import alone
from tests.support.site import Site

NOW = int(time.time())
TOPIC = "/robot/pose"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    site = Site(tmp_path / "site", clock=lambda: NOW)
    site.enroll("/viewer")
    return site


def revocations(site: Site, now: int = NOW) -> Revocations:
    held = Revocations(site.anchor.public_key)
    data = site.authority.store.newest_list()
    assert data is not None
    held.update(data, now)
    assert held.current is not None
    held.confirm(Timestamp(held.current.seq, digest(data), now, 30), now)
    return held


def authorize(site: Site, presented: bytes | None, *, topic: str = TOPIC, now: int = NOW) -> None:
    Access(alone(site.anchor, revocations(site, now))).authorize(
        site.identity("/viewer"), presented, Right.SUBSCRIBE, topic, now
    )


def field(*grants: Value) -> bytes:
    return encode(list(grants))


def test_a_peer_with_a_grant_is_authorized(site: Site) -> None:
    authorize(site, field(site.subscribe("/viewer", TOPIC)))


def test_a_peer_without_grants_is_refused(site: Site) -> None:
    with pytest.raises(GrantMissing, match="/viewer shows no grant to subscribe /robot/pose") as no:
        authorize(site, None)
    assert "rossec grant sign /viewer --subscribe /robot/pose" in no.value.hint
    with pytest.raises(GrantMissing):
        authorize(site, field())


def test_a_grant_for_another_topic_is_refused(site: Site) -> None:
    grant = site.subscribe("/viewer", TOPIC)
    with pytest.raises(GrantMissing) as caught:
        authorize(site, field(grant), topic="/robot/camera")
    assert TOPIC in caught.value.hint


def test_a_grant_to_publish_does_not_allow_subscribing(site: Site) -> None:
    with pytest.raises(GrantMissing, match="subscribe"):
        authorize(site, field(site.publish("/viewer", TOPIC)))


def test_a_grant_of_another_key_is_refused(site: Site) -> None:
    with pytest.raises(GrantNotHeld):
        authorize(site, field(site.subscribe("/other", TOPIC)))


def test_an_expired_grant_is_refused_although_it_was_verified_before(site: Site) -> None:
    grant = site.subscribe("/viewer", TOPIC, lifetime=5)
    own = Access(alone(site.anchor, revocations(site)))
    viewer = site.identity("/viewer")
    own.authorize(viewer, field(grant), Right.SUBSCRIBE, TOPIC, NOW + 1)
    with pytest.raises(GrantExpired):
        own.authorize(viewer, field(grant), Right.SUBSCRIBE, TOPIC, NOW + 10)


def test_a_grant_of_another_authority_is_refused(site: Site, tmp_path: Path) -> None:
    other = Site(tmp_path / "other", clock=lambda: NOW)
    with pytest.raises(GrantForged):
        authorize(site, field(other.subscribe("/viewer", TOPIC)))


def test_a_revoked_grant_is_refused(site: Site) -> None:
    grant = site.subscribe("/viewer", TOPIC)
    site.revoke(grant)
    with pytest.raises(GrantRevoked):
        authorize(site, field(grant))


def test_a_peer_with_a_revoked_key_is_refused(site: Site) -> None:
    grant = site.subscribe("/viewer", TOPIC)
    site.revoke(site.identity("/viewer").thumbprint)
    with pytest.raises(Revoked):
        authorize(site, field(grant))


def test_every_peer_is_refused_while_revocations_are_stale(site: Site) -> None:
    grant = site.subscribe("/viewer", TOPIC)
    own = Access(alone(site.anchor, revocations(site)))
    with pytest.raises(RevocationsStale):
        own.authorize(site.identity("/viewer"), field(grant), Right.SUBSCRIBE, TOPIC, NOW + 60)


@pytest.mark.parametrize(
    ("presented", "said"),
    [
        (b"", "unreadable list"),
        (b"\xff", "unreadable list"),
        (encode({1: b"x"}), "expected a list"),
        (encode([b"x"] * 17), "expected a list of at most 16"),
        (encode([b"x", "y"]), "an item that is not bytes"),
        (encode([b"x" * (access.MAX_PRESENTED + 1)]), "unreadable list"),
    ],
)
def test_a_malformed_list_of_grants_is_refused(site: Site, presented: bytes, said: str) -> None:
    with pytest.raises(GrantMalformed, match=said):
        authorize(site, presented)


def test_only_grants_that_cover_the_request_are_presented(site: Site) -> None:
    pose, camera = site.subscribe("/viewer", TOPIC), site.subscribe("/viewer", "/robot/camera")
    own = Access(alone(site.anchor, revocations(site)), [pose])
    own.hold(camera)
    assert set(own.current(NOW)) == {pose, camera}
    assert own.present(Right.SUBSCRIBE, TOPIC, NOW) == field(pose)
    assert own.present(Right.PUBLISH, TOPIC, NOW) == field()


def test_a_refused_grant_does_not_affect_a_valid_one(site: Site) -> None:
    good = site.subscribe("/viewer", TOPIC)
    authorize(site, field(b"garbage", good, good[:-1] + bytes([good[-1] ^ 1])))


def test_the_error_of_a_grant_takes_precedence_over_a_missing_grant(site: Site) -> None:
    expired = site.grant("/viewer", Right.SUBSCRIBE, TOPIC, begin=NOW - 100, lifetime=-10)
    with pytest.raises(GrantExpired):
        authorize(site, field(site.subscribe("/viewer", "/robot/camera"), expired))


def test_expired_grants_are_not_presented_and_their_number_is_bounded(site: Site) -> None:
    ended = site.grant("/viewer", Right.SUBSCRIBE, TOPIC, begin=NOW - 100, lifetime=-10)
    revoked = site.subscribe("/viewer", TOPIC, lifetime=10_000)
    site.revoke(revoked)
    later = [site.subscribe("/viewer", TOPIC, lifetime=100 + n) for n in range(20)]
    own = Access(alone(site.anchor, revocations(site)), [ended, revoked, *later])
    shown = own.present(Right.SUBSCRIBE, TOPIC, NOW)
    assert shown == field(*reversed(later[-access.MAX_GRANTS :]))
    authorize(site, shown)
    assert own.current(NOW) == later[::-1]


async def test_the_hint_for_a_master_without_a_list_names_the_commands_that_make_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = Site(tmp_path / "listless")
    monkeypatch.setattr(site.authority.store, "newest_list", lambda: None)
    async with site.running():
        with pytest.raises(CAError, match="the master has no revocation list") as caught:
            async with site.node("/viewer"):
                pass
    assert "rossec ca refresh" in caught.value.hint
    assert "rossec ca publish" in caught.value.hint


def test_a_list_without_a_timestamp_makes_revocations_stale(site: Site) -> None:
    """The master answers so to a revoked identity: the list is used, nothing else is trusted."""
    held, saved = revocations(site), list[bytes]()
    own = Access(alone(site.anchor, held))
    master = site.identity("/master")
    held.check_fresh(NOW)
    signed = site.revoke(bytes(32))
    for data in (signed, signed):  # also when the list is not new
        with pytest.raises(RevocationsStale, match="the revocation list without a timestamp") as stale:
            own.update_revocations(data, b"", master, NOW, saved.append)
        assert "enroll the node anew" in stale.value.hint
        assert (held.data, held.fresh_until) == (signed, 0)
    assert saved == [signed]
    assert bytes(32) in held.entries


def test_stale_revocations_do_not_hide_a_revoked_intermediate(site: Site) -> None:
    """Otherwise a master below it would end the staleness with its own timestamp."""
    held = revocations(site)
    own, above = Access(alone(site.anchor, held)), bytes(32)
    master = replace(site.identity("/master"), issuers=(above,))
    own.check_peer(master, NOW)
    held.update(site.revoke(above), NOW)
    with pytest.raises(Revoked):
        own.check_peer(master, NOW)
    timestamp = sign_timestamp(
        site.enroll("/master").credentials().signer, Timestamp(held.floor[1], digest(held.data), NOW, 30)
    )
    with pytest.raises(Revoked):
        own.update_revocations(b"", timestamp, master, NOW, list[bytes]().append)
    assert held.fresh_until == 0
    other = replace(master, issuers=(bytes([1]) * 32,))
    with pytest.raises(RevocationsStale):
        own.check_peer(other, NOW)
