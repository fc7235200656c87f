import secrets

import pytest

from ca.authority import Authority
from ca.certificates import (
    MAX_RENEWAL,
    PROFILE,
    Identity,
    Renewal,
    build_intermediate_request,
    open_renewal,
    renew_at,
    retry_delay,
    sign_renewal,
    signed_at,
)
from ca.encoding import Value
from ca.errors import CAError, CertificateExpired, ForeignCertificate, RequestRefused, Revoked
from ca.keys.signing import KeySigner, Profile
from ca.svid import build_request
from tests.support.pki import DAY, NOW, Site, new_signer

SITE = Site.create()
OLD, NEW = new_signer(), new_signer()
LEAF = SITE.authority.issue(build_request(OLD, "home", "/robot"), now=NOW, serial=2)
CSR = build_request(NEW, "home", "/robot")
DUE = NOW + 21 * DAY


def nothing_is_revoked(entry: bytes, now: int) -> None:
    assert len(entry) == 32
    assert now > 0


def asked(
    csr: bytes = CSR,
    old: KeySigner = OLD,
    chain: tuple[bytes, ...] = (LEAF,),
    now: int = DUE,
    issued: int | None = None,
) -> Renewal:
    data = sign_renewal(old, chain, csr, now if issued is None else issued)
    return open_renewal(data, SITE.anchor, now, nothing_is_revoked)


def successor(renewal: Renewal, authority: Authority = SITE.authority) -> Identity:
    der = authority.renew(renewal, now=DUE, serial=secrets.randbits(127))
    return SITE.anchor.verify([der, *authority.chain], DUE)


def test_a_new_key_takes_over() -> None:
    renewal = asked()
    assert (renewal.identity.certificate, renewal.csr) == (LEAF, CSR)
    identity = successor(renewal)
    assert (identity.name, identity.public_key) == ("/robot", NEW.public_key)
    assert identity.not_after == DUE + 30 * DAY


def test_the_key_may_stay() -> None:
    assert successor(asked(build_request(OLD, "home", "/robot"))).public_key == OLD.public_key


def test_no_successor_lives_longer() -> None:
    short = SITE.authority.issue(build_request(OLD, "home", "/robot"), now=NOW, serial=3, lifetime=DAY)
    late = NOW + DAY - 3600
    renewal = asked(chain=(short,), now=late)
    der = SITE.authority.renew(renewal, now=late, serial=4)
    assert SITE.anchor.verify([der], late).not_after == late + renewal.max_lifetime
    assert renewal.max_lifetime == DAY


@pytest.mark.parametrize("life", [120, 2 * 3600, DAY, 30 * DAY])
def test_a_line_of_successors_lives_no_longer_each(life: int) -> None:
    """The hour by which certificates are backdated was added at each renewal: 2 min, then 62."""
    now, csr = NOW, build_request(OLD, "home", "/robot")
    leaf = SITE.authority.issue(csr, now=now, serial=10, lifetime=life)
    for serial in range(11, 16):
        identity = SITE.anchor.verify([leaf], now)
        assert identity.not_after == now + life
        due = renew_at(identity.not_before, identity.not_after)
        assert due == now + life * 2 // 3
        with pytest.raises(CAError, match="is not due for renewal for 1 s"):
            asked(csr, chain=(leaf,), now=now + life // 2 - 1)
        now = due
        leaf = SITE.authority.renew(asked(csr, chain=(leaf,), now=now), now=now, serial=serial)


def test_all_of_a_certificate_that_is_not_backdated_is_its_life() -> None:
    assert signed_at(NOW, NOW + 3600) == NOW
    assert signed_at(NOW, NOW + 3601) == NOW + 3600


@pytest.mark.parametrize(("life", "pause"), [(10, 1), (120, 6), (4 * 3600, 600), (DAY, 600)])
def test_a_short_life_leaves_time_to_ask_again(life: int, pause: int) -> None:
    assert retry_delay(NOW - 3600, NOW + life, 600) == pause


def test_an_intermediate_that_may_only_renew() -> None:
    host = new_signer()
    request = build_intermediate_request(host, "home")
    der = SITE.authority.issue_intermediate(request, now=DUE, serial=5, may_enroll=False, lifetime=90 * DAY)
    below = Authority(host, SITE.root, der)
    identity = successor(asked(), below)
    assert identity.issuers == (below.issuer.thumbprint,)
    again = open_renewal(
        sign_renewal(NEW, (identity.certificate, der), CSR, DUE + 21 * DAY),
        SITE.anchor,
        DUE + 21 * DAY,
        nothing_is_revoked,
    )
    assert again.identity == identity


def test_renewal_begins_after_two_thirds_of_the_lifetime() -> None:
    identity = SITE.anchor.verify([LEAF], NOW)
    assert renew_at(identity.not_before, identity.not_after) == NOW + 20 * DAY


def test_an_identity_is_not_renewed_before_half_its_life() -> None:
    half = NOW + 15 * DAY
    asked(now=half)
    with pytest.raises(CAError, match=r"/robot is not due for renewal for 1 s") as caught:
        asked(now=half - 1)
    assert "rossec ca renew" in caught.value.hint


def test_the_old_key_must_sign() -> None:
    with pytest.raises(CAError, match="the renewal is not signed by /robot"):
        asked(old=NEW)


def test_the_old_identity_must_be_good() -> None:
    with pytest.raises(CertificateExpired):
        asked(now=NOW + 31 * DAY)
    with pytest.raises(ForeignCertificate):
        asked(chain=(Site.create().leaf("/robot"),))


@pytest.mark.parametrize("which", [0, 1])
def test_neither_it_nor_its_intermediate_may_be_revoked(which: int) -> None:
    host = new_signer()
    der = SITE.authority.issue_intermediate(
        build_intermediate_request(host, "home"), now=NOW, serial=5, may_enroll=True, lifetime=90 * DAY
    )
    below = Authority(host, SITE.root, der)
    leaf = below.issue(build_request(OLD, "home", "/robot"), now=NOW, serial=6)
    identity = SITE.anchor.verify([leaf, der], NOW)

    def check(entry: bytes, now: int) -> None:
        if entry == identity.keys[which]:
            raise Revoked(f"revoked at {now}")

    data = sign_renewal(OLD, (leaf, der), CSR, DUE)
    with pytest.raises(Revoked):
        open_renewal(data, SITE.anchor, DUE, check)


def test_an_identity_renews_only_its_own_name() -> None:
    with pytest.raises(CAError, match="/robot requests the identity of /master"):
        asked(build_request(NEW, "home", "/master"))
    with pytest.raises(RequestRefused, match="trust domain 'lab'"):
        asked(build_request(NEW, "lab", "/robot"))
    with pytest.raises(RequestRefused, match="not a certificate request"):
        asked(b"nothing")


@pytest.mark.parametrize("shift", [-301, 301])
def test_neither_old_nor_from_the_future(shift: int) -> None:
    with pytest.raises(CAError, match="too old, or from the future"):
        asked(issued=DUE + shift)
    asked(issued=DUE + shift - (1 if shift > 0 else -1))


def refused(data: bytes, message: str) -> None:
    with pytest.raises(CAError, match=message):
        open_renewal(data, SITE.anchor, DUE, nothing_is_revoked)


@pytest.mark.parametrize(
    "payload",
    [
        {},
        {6: DUE, -70021: CSR},
        {6: DUE, -70021: CSR, -70022: [LEAF], 7: 1},
        {6: True, -70021: CSR, -70022: [LEAF]},
        {6: DUE, -70021: "csr", -70022: [LEAF]},
        {6: DUE, -70021: CSR, -70022: LEAF},
        {6: DUE, -70021: CSR, -70022: []},
        {6: DUE, -70021: CSR, -70022: [LEAF, LEAF, LEAF]},
    ],
)
def test_unknown_or_missing_fields_are_refused(payload: Value) -> None:
    refused(PROFILE.sign(OLD, payload), "missing or unknown fields")


def test_a_chain_is_of_certificates() -> None:
    refused(PROFILE.sign(OLD, {6: DUE, -70021: CSR, -70022: [LEAF, 1]}), "not a list of certificates")


def test_only_a_renewal_is_opened_as_one() -> None:
    payload: Value = {6: DUE, -70021: CSR, -70022: [LEAF]}
    refused(Profile("rossec-grant+cwt").sign(OLD, payload), "this is not a renewal")
    refused(b"", "this is not a renewal")
    refused(bytes(MAX_RENEWAL + 1), "this is not a renewal")


def test_a_truncated_or_extended_renewal_is_refused() -> None:
    data = sign_renewal(OLD, (LEAF,), CSR, DUE)
    refused(data + b"\0", "this is not a renewal")
    for end in range(0, len(data), 7):
        with pytest.raises(CAError, match="this is not a renewal"):
            open_renewal(data[:end], SITE.anchor, DUE, nothing_is_revoked)
    flipped = bytearray(data)
    flipped[-1] ^= 1
    refused(bytes(flipped), "is not signed by /robot")
