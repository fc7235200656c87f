"""Attacks on renewals by the authority's service: another's name, floods, forged answers."""

import contextlib
import hashlib
from pathlib import Path
from typing import Any

import pytest

from ca.certificates import sign_renewal
from ca.errors import CAError, Revoked, StoreError
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.svid import build_request
from rossec.authority.renewals import renew_by_name, renew_recorded
from rossec.home import NodeHome
from rossec.master.rights.renewals import IdentityRenewals, Settlement
from rossec.ros.names import RENEW_IDENTITY, SETTLE_RENEWALS, WATCH_RENEWALS
from tests.support.attacker import EVE, call, credentials
from tests.support.site import DAY, Site

BEGAN = 1_800_000_000
LIFE = 30 * DAY
NOW = BEGAN + 25 * DAY


@pytest.fixture
def site(tmp_path: Path) -> Site:
    """A site whose nodes were enrolled 25 days ago, for 30."""
    site = Site(tmp_path / "site", clock=lambda: BEGAN)
    for name in ("/robot", EVE):
        site.enroll(name, LIFE)
    return site


def asks(home: NodeHome, name: str, key: KeySigner | None = None, at: int = NOW) -> bytes:
    own = home.credentials()
    csr = build_request(own.signer if key is None else key, "home", name)
    return sign_renewal(own.signer, own.chain, csr, at)


def recorded(site: Site, name: str) -> int:
    return len(site.authority.store.identities.by_name(name))


@pytest.mark.attack("renewal-for-another")
def test_a_node_gets_no_identity_of_another_name_or_key(site: Site) -> None:
    robot, eve = site.enroll("/robot"), site.enroll(EVE)
    table = IdentityRenewals(site.anchor)
    keys = {name: home.identity(BEGAN).thumbprint for name, home in (("/robot", robot), (EVE, eve))}
    forged = [
        (keys[EVE], asks(eve, "/robot")),  # her key, another name
        (keys[EVE], asks(robot, "/robot")),  # a request that she recorded
    ]
    for holder, request in forged:
        with pytest.raises(CAError, match=r"(requests the identity of|is not of) /robot"):
            table.ask(holder, request, NOW, lambda *_: None)
    with pytest.raises(CAError, match="requests the identity of /robot"):
        renew_recorded(site.authority, asks(eve, "/robot"), NOW)
    assert recorded(site, "/robot") == 1


@pytest.mark.attack("renewal-for-another")
def test_what_is_revoked_replaced_or_unknown_gets_nothing(site: Site, tmp_path: Path) -> None:
    robot = site.enroll("/robot")
    request = asks(robot, "/robot")
    other = build_request(KeySigner(generate()), "home", "/robot")
    site.authority.issue(other, NOW - DAY, LIFE, replace_key="/robot")
    with pytest.raises(Revoked):  # the replaced key is revoked with it
        renew_recorded(site.authority, request, NOW)
    eve = site.enroll(EVE)
    site.authority.revoke(eve.identity(BEGAN).thumbprint, "stolen", NOW)
    with pytest.raises(Revoked):
        renew_recorded(site.authority, asks(eve, EVE), NOW)
    for expired in (False, True):
        with pytest.raises(StoreError, match=f"the identity of {EVE} is revoked"):
            renew_by_name(site.authority, EVE, NOW + LIFE, expired=expired)
    with contextlib.closing(Site(tmp_path / "other", clock=lambda: BEGAN).authority.store) as empty:
        site.authority.store = empty  # a record restored from before the node was enrolled
        with pytest.raises(CAError, match="/robot is not in the authority's record"):
            renew_recorded(site.authority, asks(robot, "/robot"), NOW)


@pytest.mark.attack("renewal-flood")
def test_one_node_cannot_fill_the_record(site: Site) -> None:
    """Whatever it asks, while its newest identity is not due there is one certificate."""
    robot = site.enroll("/robot")
    bundles = {renew_recorded(site.authority, asks(robot, "/robot"), NOW + at) for at in range(20)}
    assert (len(bundles), recorded(site, "/robot")) == (1, 2)
    eve, refused = site.enroll(EVE), 0
    for at in range(20):
        try:
            renew_recorded(site.authority, asks(eve, EVE, KeySigner(generate())), NOW + at)
        except CAError as error:
            refused += "has a newer identity" in str(error)
    assert (refused, recorded(site, EVE)) == (19, 2)


@pytest.mark.attack("renewal-flood")
def test_one_key_has_one_place_at_the_master(site: Site) -> None:
    eve, asked = site.enroll(EVE), list[int]()
    table = IdentityRenewals(site.anchor)
    table.on_asked = lambda: asked.append(1)
    key = eve.identity(BEGAN).thumbprint
    for at in range(50):
        table.ask(key, asks(eve, EVE, KeySigner(generate()), NOW + at), NOW + at, lambda *_: None)
    assert table.waiting(NOW + 50) == 1
    assert len(asked) == 1
    assert len(table.offer(NOW + 50, locked=False).requests) == 1


@pytest.mark.attack("clock-ahead")
def test_a_refusal_of_a_clock_that_was_ahead_does_not_stay(site: Site) -> None:
    """The clock of the master's host was two days ahead, and a node's on it: both are right again.

    The authority, whose clock was right, refused the request as one from the future.
    """
    robot, table = site.enroll("/robot"), IdentityRenewals(site.anchor)
    key, ahead = robot.identity(BEGAN).thumbprint, NOW + 2 * DAY
    table.ask(key, asks(robot, "/robot", at=ahead), ahead, lambda *_: None)
    [request] = table.offer(ahead, locked=False).requests
    refusal = Settlement(hashlib.sha256(request).digest(), b"", "it is from the future")
    assert table.settle([refusal], ahead, lambda *_: None) == 1
    with pytest.raises(CAError, match="from the future"):
        table.ask(key, asks(robot, "/robot", at=ahead), ahead, lambda *_: None)
    assert table.ask(key, asks(robot, "/robot"), NOW, lambda *_: None).bundle == b""
    [again] = table.offer(NOW + 1, locked=False).requests
    bundle = renew_recorded(site.authority, again, NOW + 1)
    answer = Settlement(hashlib.sha256(again).digest(), bundle, "")
    assert table.settle([answer], NOW + 1, lambda *_: None) == 1
    assert table.ask(key, asks(robot, "/robot", at=NOW + 5), NOW + 5, lambda *_: None).bundle


@pytest.mark.attack("forged-renewal-answer")
async def test_only_the_authority_sees_requests_and_leaves_answers(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    async with site.running():
        assert site.master is not None
        uri, own = site.master.uri, credentials(site, EVE)
        for method, argument in ((WATCH_RENEWALS, 0), (SETTLE_RENEWALS, [[bytes(32), b"x", ""]])):
            answer: Any = await call(uri, own, method, EVE, argument)
            assert answer[0] == -1
            assert "only the authority's own node /ca may call this" in answer[1]
        answer = await call(uri, own, RENEW_IDENTITY, EVE, b"noise")
        assert (answer[0], answer[2]) == (-1, b"")
        assert "this is not a renewal" in answer[1]
