"""Renewal: the grant is unchanged, and every attack with a master's or holder's key is refused."""

from dataclasses import replace
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, encode
from ca.errors import Revoked
from ca.keys.signing import KeySigner, thumbprint
from grants import document
from grants.decision import authorize
from grants.document import issuer_uri
from grants.errors import (
    GrantExpired,
    GrantForged,
    GrantForOther,
    GrantMalformed,
    GrantRevoked,
    GrantTooWide,
    RenewalNotInTime,
)
from grants.model import Grant, Right
from grants.renewal import (
    DELEGATION,
    MAX_DELEGATION,
    MAX_TICKET,
    TICKET,
    Delegation,
    Ticket,
    open_delegation,
    open_ticket,
    renew,
    sign_delegation,
    sign_ticket,
)
from tests.grants.authority import CA, DRAFT, HOLDER, NOW, OTHER_CA

MASTER, OTHER_KEY = (KeySigner(ec.generate_private_key(ec.SECP256R1())) for _ in range(2))
DATA = document.sign(CA, DRAFT)
GRANT = document.verify(DATA, CA.public_key)
LATER = DRAFT.expires + 5
DELEGATED = Delegation(
    "home", thumbprint(MASTER.public_key), NOW - 10, NOW + 5000, max_ttl=600, serial=bytes(16)
)
VALID_TICKET = Ticket(GRANT.id, LATER - 5, LATER + 300, seq=7)


def renewed(
    grant: Grant = GRANT,
    *,
    ticket: Ticket = VALID_TICKET,
    data: bytes | None = None,
    signer: KeySigner = MASTER,
    delegated: Delegation = DELEGATED,
    key: KeySigner = MASTER,
    now: int = LATER,
    seq: int = 7,
    revoked: bytes = b"",
    authority: KeySigner = CA,
) -> Grant:
    def check(entry: bytes, _: int) -> None:
        if entry == revoked:
            raise Revoked("it is on the list")

    delegation = open_delegation(sign_delegation(authority, delegated), authority.public_key)
    signed = sign_ticket(signer, ticket) if data is None else data
    return renew(grant, signed, delegation, key.public_key, now=now, seq=seq, check=check)


def test_renewal_changes_only_the_expiry() -> None:
    with pytest.raises(GrantExpired):
        document.open_grant(DATA, CA.public_key, LATER)
    grant = renewed()
    assert grant.via[1] == thumbprint(MASTER.public_key)
    assert grant == replace(GRANT, expires=VALID_TICKET.expires, via=grant.via)
    decided = authorize(
        [grant], Right.SUBSCRIBE, "/robot/pose", holder=HOLDER, now=LATER, check=lambda *_: None
    )
    assert decided.expires == VALID_TICKET.expires
    assert decided.grant_ids == (GRANT.id, *grant.via)


def test_renewal_at_the_bounds() -> None:
    renewed(ticket=replace(VALID_TICKET, expires=VALID_TICKET.not_before + DELEGATED.max_ttl))
    renewed(ticket=replace(VALID_TICKET, not_before=GRANT.cap - 600, expires=GRANT.cap), now=GRANT.cap - 1)
    renewed(seq=8)
    renewed(now=VALID_TICKET.not_before)


def delegation_id() -> bytes:
    return open_delegation(sign_delegation(CA, DELEGATED), CA.public_key).id


def ticket(**changes: Any) -> dict[str, Any]:
    return {"ticket": replace(VALID_TICKET, **changes)}


def delegated(**changes: Any) -> dict[str, Any]:
    return {"delegated": replace(DELEGATED, **changes)}


END = GRANT.cap
INVALID: dict[str, tuple[dict[str, Any], type[Exception], str]] = {
    "ticket of another grant": (ticket(grant=bytes(16)), GrantForOther, "is not for grant"),
    "too long": (ticket(expires=VALID_TICKET.not_before + 601), GrantTooWide, "more than 600 s"),
    "beyond the cap": (
        ticket(not_before=END - 5, expires=END + 1) | {"now": END - 1},
        GrantTooWide,
        "the grant's cap",
    ),
    "after the cap": (
        ticket(not_before=END, expires=END + 1) | {"now": END},
        GrantTooWide,
        "the grant's cap",
    ),
    "beyond the delegation": (delegated(expires=LATER + 100), GrantTooWide, "delegation's end"),
    "after the delegation": (
        delegated(expires=LATER) | ticket(expires=LATER),
        RenewalNotInTime,
        "delegation expired",
    ),
    "before the delegation": (delegated(not_before=LATER + 1), RenewalNotInTime, "tion is not"),
    "before the ticket": (ticket(not_before=LATER + 1), RenewalNotInTime, "ticket is not valid"),
    "after the ticket": (ticket(expires=LATER), RenewalNotInTime, "ticket expired"),
    "before the grant": (
        {"grant": replace(GRANT, not_before=LATER + 1, expires=LATER + 2)},
        RenewalNotInTime,
        "grant is not valid",
    ),
    "revoked grant": ({"revoked": GRANT.id}, GrantRevoked, "grant .*: it is on the list"),
    "revoked delegation": ({"revoked": delegation_id()}, GrantRevoked, "delegation .*: it is on"),
    "foreign signer": ({"signer": OTHER_KEY}, GrantForged, "does not verify"),
    "foreign key": ({"signer": OTHER_KEY, "key": OTHER_KEY}, GrantForOther, "another key"),
    "another authority": ({"authority": OTHER_CA}, GrantForOther, "another authority"),
    "another domain": (delegated(domain="work"), GrantForOther, "or domain"),
    "a grant as ticket": ({"data": DATA}, GrantForged, "not a statement of kind"),
    "a delegation as ticket": ({"data": sign_delegation(MASTER, DELEGATED)}, GrantForged, "kind"),
    "a grant that is not renewable": (
        {"grant": replace(GRANT, expires=GRANT.cap)},
        GrantTooWide,
        "not renewable",
    ),
    "an older own list": ({"seq": 6}, RenewalNotInTime, "requires revocation list 7, this host has 6"),
}


@pytest.mark.parametrize("name", INVALID)
def test_an_invalid_renewal_is_refused(name: str) -> None:
    changes, error, message = INVALID[name]
    with pytest.raises(error, match=message):
        renewed(**changes)


def test_a_grant_changed_and_signed_by_the_master_is_refused() -> None:
    with pytest.raises(GrantForged):
        document.verify(document.sign(MASTER, replace(DRAFT, expires=DRAFT.cap)), CA.public_key)


def test_a_delegation_signed_by_the_master_is_refused() -> None:
    with pytest.raises(GrantForged, match="does not verify"):
        open_delegation(sign_delegation(MASTER, DELEGATED), CA.public_key)


def test_a_ticket_is_not_accepted_as_delegation() -> None:
    with pytest.raises(GrantForged, match="not a statement of kind"):
        open_delegation(sign_ticket(CA, VALID_TICKET), CA.public_key)


CLAIMS: dict[int | str, Value] = {
    1: issuer_uri(thumbprint(CA.public_key)),
    3: "home",
    4: NOW + 100,
    5: NOW,
    7: bytes(16),
    8: {5: bytes(32)},
    -70010: 600,
}
TICKET_CLAIMS: dict[int | str, Value] = {4: NOW + 100, 5: NOW, -70002: 1, -70011: bytes(16)}


def test_the_issuer_of_a_delegation_is_the_signer() -> None:
    assert open_delegation(DELEGATION.sign(CA, CLAIMS), CA.public_key).max_ttl == 600
    other = issuer_uri(thumbprint(OTHER_CA.public_key))
    with pytest.raises(GrantForOther, match="iss is another"):
        open_delegation(DELEGATION.sign(CA, CLAIMS | {1: other}), CA.public_key)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({99: 1}, "missing or unknown claims"),
        ({8: {5: bytes(32), 1: 1}}, "missing or unknown claims"),
        ({8: 1}, "missing or unknown claims"),
        ({1: "urn:x"}, "in a delegation: iss is not the thumbprint URI"),
        ({3: ""}, "needs a trust domain"),
        ({4: "x"}, "of a wrong type"),
        ({4: True}, "of a wrong type"),
        ({4: NOW}, "not_before < expires"),
        ({4: 1 << 60}, "not_before < expires"),
        ({5: -1}, "not_before < expires"),
        ({4: NOW + MAX_DELEGATION + 1}, "at most 90 days"),
        ({7: b""}, "holder must be 32 bytes"),
        ({8: {5: b""}}, "holder must be 32 bytes"),
        ({-70010: 0}, "its tickets 7"),
        ({-70010: MAX_TICKET + 1}, "its tickets 7"),
    ],
)
def test_delegations_outside_the_schema(change: dict[int | str, Value], message: str) -> None:
    with pytest.raises(GrantMalformed, match=message):
        open_delegation(DELEGATION.sign(CA, CLAIMS | change), CA.public_key)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({9: encode([])}, "missing or unknown claims"),
        ({-70011: "x"}, "missing or unknown claims"),
        ({-70011: b"x"}, "a grant id of 16 bytes"),
        ({-70002: -1}, "the number of a list"),
        ({-70002: 1.5}, "of a wrong type"),
        ({4: NOW}, "not_before < expires"),
    ],
)
def test_tickets_outside_the_schema(change: dict[int | str, Value], message: str) -> None:
    with pytest.raises(GrantMalformed, match=message):
        open_ticket(TICKET.sign(MASTER, TICKET_CLAIMS | change), MASTER.public_key)


def test_damaged_tickets_are_refused() -> None:
    data = sign_ticket(MASTER, VALID_TICKET)
    for damaged in [*(data[:end] for end in range(len(data))), data + b"\0", bytes(2000)]:
        with pytest.raises((GrantForged, GrantMalformed)):
            open_ticket(damaged, MASTER.public_key)
    long = MASTER.sign(encode(["Signature1", TICKET.protected, b"", b"\x18\x01"]))
    with pytest.raises(GrantMalformed, match="deterministic"):
        open_ticket(b"\xd2" + encode([TICKET.protected, {}, b"\x18\x01", long]), MASTER.public_key)
