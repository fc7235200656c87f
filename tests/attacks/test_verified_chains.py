"""A chain whose signatures were verified before: it counts for nothing that is over since then."""

from copy import copy
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca import certificates
from ca.authority import Authority
from ca.bounded import Newest
from ca.certificates import Identity, build_intermediate_request
from ca.domains import Anchors
from ca.errors import CAError, CertificateExpired, ForeignCertificate, NotAdmitted, RevocationsStale, Revoked
from ca.keys.signing import thumbprint
from ca.revocation.lists import MAX_AGE
from ca.revocation.trust_status import Revocations, TrustStatus
from ca.svid import build_request
from tests.support.domains import Pair, domains, foreign
from tests.support.pki import DAY, NOW, Site, new_signer

pytestmark = pytest.mark.attack("kept-chain")

PAIR = Pair()
HOME, HOSPITAL = PAIR.home, PAIR.hospital
HOST = new_signer()
BELOW = HOME.authority.issue_intermediate(
    build_intermediate_request(HOST, "home"), now=NOW, serial=77, may_enroll=True, lifetime=2 * DAY
)
SEASON = Site(HOME.key, HOME.root, Authority(HOST, HOME.root, BELOW), HOME.anchor)
AGAIN = Site.create(HOSPITAL.anchor.domain)  # another root of that domain
OURS, LATER, SEASONAL = HOME.leaf(), HOME.leaf(now=NOW + 3 * DAY), SEASON.leaf()
SHORT = HOME.authority.issue(
    build_request(new_signer(), "home", "/robot1/arm"), now=NOW, serial=78, lifetime=3600
)
VISITOR, INTRUDER = HOSPITAL.leaf("/rounds/cart"), HOSPITAL.leaf("/kitchen")
CHAINS = (
    (OURS,),
    (LATER,),
    (SHORT,),
    (SEASONAL, BELOW),
    (SEASONAL,),
    (OURS, BELOW),
    (BELOW, SEASONAL),
    (VISITOR,),
    (INTRUDER,),
    (VISITOR, BELOW),
    (HOSPITAL.leaf("/master"),),
    (AGAIN.leaf("/rounds/cart"),),
    (Site.create("home").leaf(),),
    (OURS[:-1] + bytes([OURS[-1] ^ 1]),),
    (OURS, BELOW, BELOW),
    (),
)
LISTS: tuple[tuple[dict[str, Any], ...], ...] = (
    (),
    ({},),
    ({"admitted": ("/kitchen",)},),
    ({"label": "clinic"},),
    ({"until": NOW + DAY},),
    ({"root": AGAIN.root},),
)
KEYS = (
    HOME.anchor.verify((OURS,), NOW).thumbprint,
    HOME.anchor.verify((SEASONAL, BELOW), NOW).thumbprint,
    HOSPITAL.anchor.verify((VISITOR,), NOW).thumbprint,
    thumbprint(HOST.public_key),
)

Step = tuple[str, int]
STEPS = st.lists(
    st.one_of(
        st.tuples(st.just("chain"), st.integers(0, len(CHAINS) - 1)),
        st.tuples(st.just("clock"), st.integers(-6 * DAY, 6 * DAY)),
        st.tuples(st.just("domains"), st.integers(0, len(LISTS) - 1)),
        st.tuples(st.just("revoke"), st.integers(0, len(KEYS) - 1)),
        st.tuples(st.just("confirm"), st.integers(0, 1)),
    ),
    max_size=30,
)


def uncached(pair: Pair, chain: tuple[bytes, ...], now: int) -> Identity:
    """What a process that was just started makes of it: every root is read, every signature verified."""
    with patch.object(certificates, "_loaded", Newest[bytes, certificates.TrustAnchor](0)):
        anchors = Anchors(replace(HOME.anchor))
        if pair.anchors.data:
            anchors.update(pair.anchors.data)
        return anchors.verify(chain, now)


def outcome(pair: Pair, verify: Any, chain: tuple[bytes, ...], now: int) -> object:
    try:
        identity = verify(chain, now)
        pair.trust_status.check_peer(identity, now)
    except CAError as error:
        return type(error), str(error), error.hint
    return identity


def fresh() -> Pair:
    """The same sites, and a node that has just been started."""
    pair = copy(PAIR)
    pair.own, pair.anchors = Revocations(HOME.anchor.public_key), Anchors(HOME.anchor)
    pair.anchors.update(domains(HOME, foreign(HOSPITAL)))
    pair.trust_status = TrustStatus(pair.anchors, pair.own)
    return pair


@given(STEPS)
def test_a_kept_chain_is_judged_as_one_never_seen(steps: list[Step]) -> None:
    pair, now, seq, revoked = fresh(), NOW, 2, list[bytes]()
    for what, value in steps:
        match what:
            case "chain":
                for chain in (CHAINS[value], *CHAINS[:4]):
                    expected = outcome(pair, lambda *each: uncached(pair, *each), chain, now)
                    assert outcome(pair, pair.anchors.verify, chain, now) == expected
            case "clock":
                now = max(NOW - 30 * DAY, now + value)
            case "domains":
                seq += 1
                entries = (replace(foreign(HOSPITAL), **changes) for changes in LISTS[value])
                pair.anchors.update(domains(HOME, *entries, seq=seq, issued=NOW - DAY, life=8 * DAY))
            case "revoke":
                revoked.append(KEYS[value])
                seq += 1
                pair.confirm_own(*revoked, seq=seq, now=NOW)
            case _:
                seq += 1
                try:
                    pair.confirm_own(*revoked, seq=seq, now=now)
                    pair.confirm_foreign(*revoked[: value + 1], seq=seq, now=now)
                except CAError:
                    continue  # the clock is before or behind it, or the domain is not listed


@pytest.fixture
def pair() -> Pair:
    pair = fresh()
    pair.confirm_own()
    pair.confirm_foreign()
    for chain in ((OURS,), (SEASONAL, BELOW), (VISITOR,)):
        admit(pair, chain, NOW)
    return pair


def admit(pair: Pair, chain: tuple[bytes, ...], now: int) -> Identity:
    """What a handshake and the connection header after it ask."""
    identity = pair.anchors.verify(chain, now)
    pair.trust_status.check_peer(identity, now)
    return identity


def test_kept_past_its_end(pair: Pair) -> None:
    with pytest.raises(CertificateExpired):
        admit(pair, (OURS,), NOW + 40 * DAY)
    with pytest.raises(CertificateExpired, match="intermediate's certificate expired"):
        admit(pair, (SEASONAL, BELOW), NOW + 3 * DAY)


def test_kept_past_its_revocation(pair: Pair) -> None:
    pair.confirm_own(KEYS[0], thumbprint(HOST.public_key), seq=2)
    for chain in ((OURS,), (SEASONAL, BELOW)):
        with pytest.raises(Revoked):
            admit(pair, chain, NOW)
    pair.confirm_foreign(KEYS[2], seq=2)
    with pytest.raises(Revoked):
        admit(pair, (VISITOR,), NOW)


def test_kept_past_what_is_known_of_revocations(pair: Pair) -> None:
    with pytest.raises(RevocationsStale):
        admit(pair, (OURS,), NOW + 2 * MAX_AGE)


@pytest.mark.parametrize(
    ("listed", "refusal"),
    [(LISTS[0], ForeignCertificate), (LISTS[2], NotAdmitted), (LISTS[5], ForeignCertificate)],
)
def test_kept_past_the_trust_in_its_domain(
    pair: Pair, listed: tuple[dict[str, Any], ...], refusal: type[CAError]
) -> None:
    entries = (replace(foreign(HOSPITAL), **changes) for changes in listed)
    pair.anchors.update(domains(HOME, *entries, seq=2))
    with pytest.raises(refusal):
        admit(pair, (VISITOR,), NOW)


def test_kept_past_the_list_of_domains(pair: Pair) -> None:
    with pytest.raises(NotAdmitted, match="the trust in domain hospital has ended"):
        admit(pair, (VISITOR,), NOW + 11 * DAY)
    pair.anchors.update(domains(HOME, foreign(HOSPITAL), seq=2, life=DAY))
    with pytest.raises(NotAdmitted, match="the list of domains has expired"):
        admit(pair, (VISITOR,), NOW + DAY)
