"""Tokens: plain and renewed grants, and every kind of invalid token."""

from dataclasses import replace
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import encode
from ca.errors import Revoked
from ca.keys.signing import KeySigner, thumbprint
from grants import document
from grants.decision import authorize
from grants.errors import GrantExpired, GrantForged, GrantForOther, GrantMalformed, GrantRevoked
from grants.model import Right
from grants.renewal import Delegation, Ticket, sign_delegation, sign_ticket
from grants.token import TokenParts, Verifier, pack, pack_chain, peek, unpack
from tests.grants.authority import CA, DRAFT, HOLDER, NOW, OTHER_CA, draft
from tests.grants.chains import A, B, Made, first, key_of

MASTER = KeySigner(ec.generate_private_key(ec.SECP256R1()))
DATA = document.sign(CA, DRAFT)
ID = document.grant_id(DATA)
LATER = DRAFT.expires + 5
DELEGATION = sign_delegation(
    CA, Delegation("home", thumbprint(MASTER.public_key), NOW - 10, NOW + 5000, 600, bytes(16))
)
TICKET = sign_ticket(MASTER, Ticket(ID, LATER - 5, LATER + 300, seq=7))
TOKEN = pack(DATA, TICKET, DELEGATION)


def accept(*_: object) -> None:
    """Nothing is revoked."""


VERIFIER = Verifier(CA.public_key, "home", (MASTER.public_key,), 7, accept)


def test_a_grant_without_renewal_is_its_own_token() -> None:
    assert unpack(DATA) == TokenParts(DATA)
    assert VERIFIER.open(DATA, NOW) == document.open_grant(DATA, CA.public_key, NOW)
    with pytest.raises(GrantExpired):
        VERIFIER.open(DATA, LATER)


def test_a_renewed_grant_is_valid_until_its_ticket_ends() -> None:
    assert unpack(TOKEN) == TokenParts(DATA, TICKET, DELEGATION)
    grant = VERIFIER.open(TOKEN, LATER)
    assert (grant.id, grant.expires) == (ID, LATER + 300)


def test_a_renewed_grant_is_refused_without_the_masters_key() -> None:
    with pytest.raises(GrantForOther, match="the master's key is not known"):
        replace(VERIFIER, delegates=()).open(TOKEN, LATER)


def test_a_renewal_counts_from_each_master_that_is_known() -> None:
    other = ec.generate_private_key(ec.SECP256R1()).public_key()
    for keys in ((other, MASTER.public_key), (MASTER.public_key, other)):
        assert replace(VERIFIER, delegates=keys).open(TOKEN, LATER).id == ID
    with pytest.raises(GrantForOther, match="for another key than this one"):
        replace(VERIFIER, delegates=(other,)).open(TOKEN, LATER)


@pytest.mark.parametrize("which", [0, 1])
def test_a_renewal_by_a_revoked_delegation_or_delegate_is_refused(which: int) -> None:
    grant = VERIFIER.open(TOKEN, LATER)

    def check(entry: bytes, _: int) -> None:
        if entry == grant.via[which]:
            raise Revoked("it is on the list")

    with pytest.raises(GrantRevoked):
        replace(VERIFIER, check=check).open(TOKEN, LATER)
    request: dict[str, Any] = {"holder": HOLDER, "now": LATER}
    decided = authorize([grant], Right.SUBSCRIBE, "/robot/pose", **request, check=accept)
    assert decided.grant_ids == (ID, *grant.via)
    with pytest.raises(GrantRevoked):
        authorize([grant], Right.SUBSCRIBE, "/robot/pose", **request, check=check)


@pytest.mark.parametrize(
    "broken",
    [
        encode([DATA, TICKET, b""]),
        encode([DATA, TICKET, 5]),
        encode([DATA, TICKET, DELEGATION]) + b"\0",
        b"\x83",
    ],
)
def test_an_invalid_token_is_refused(broken: bytes) -> None:
    with pytest.raises(GrantMalformed, match="renewed grant"):
        unpack(broken)


def test_a_chain_is_its_first_token_and_the_narrowings() -> None:
    base = first()
    longer = base.narrowed(A).narrowed(B)
    parts = unpack(longer.token)
    assert (parts.grant, parts.ticket, len(parts.narrowings)) == (base.token, b"", 2)
    assert pack_chain(base.token, parts.narrowings) == longer.token
    assert longer.token[0] == 0x82
    grant = VERIFIER.open(longer.token, NOW)
    assert grant == peek(longer.token)
    assert [link.subject for link in grant.links] == ["/remote/hospital/a", "/b", "/c"]


def test_the_end_of_a_chain_below_a_renewed_grant_is_that_of_the_ticket() -> None:
    base = document.sign(CA, draft(holder=key_of(A), subject="/a", may_narrow=1, expires=NOW + 10))
    opened = document.peek(base)
    ticket = sign_ticket(MASTER, Ticket(opened.id, NOW + 5, NOW + 300, seq=7))
    made = Made(pack(base, ticket, DELEGATION), opened).narrowed(A, expires=NOW + 900)
    parts = unpack(made.token)
    assert (parts.ticket, parts.delegation, len(parts.narrowings)) == (ticket, DELEGATION, 1)
    grant = VERIFIER.open(made.token, NOW + 20)
    assert (grant.expires, grant.cap) == (NOW + 300, NOW + 300)
    assert set(grant.links[0].via) <= set(grant.revocable)
    with pytest.raises(GrantForOther):
        replace(VERIFIER, delegates=()).open(made.token, NOW + 20)


def test_the_signature_and_the_end_of_the_first_link_count() -> None:
    made = first().narrowed(A)
    other = replace(VERIFIER, ca_key=OTHER_CA.public_key)
    with pytest.raises(GrantForged):
        other.open(made.token, NOW)
    with pytest.raises(GrantForged):
        replace(VERIFIER, domain="work").open(made.token, NOW)
    with pytest.raises(GrantExpired):
        VERIFIER.open(first(expires=NOW, cap=NOW).narrowed(A).token, NOW)


def nested(*narrowings: Any, single: Any = b"\xd2") -> bytes:
    return encode([single, [*narrowings]])


@pytest.mark.parametrize(
    "broken",
    [
        nested(),
        nested(*[b"n"] * 4),
        nested(b""),
        nested(5),
        nested(b"n", single=5),
        nested(b"n") + b"\0",
        nested(bytes(16 * 1024 + 1)),
        nested(*[bytes(16 * 1024)] * 3, single=bytes(16 * 1024)),  # above 64 KiB
        b"\x82" + bytes(64 * 1024),
        b"\x82",
        encode([b"\xd2", b"n"]),
        encode([b"\xd2", [[b"n"]]]),
    ],
    ids=len,
)
def test_an_invalid_chain_is_refused(broken: bytes) -> None:
    for reading in (unpack, peek, lambda token: VERIFIER.open(token, NOW)):
        with pytest.raises(GrantMalformed):
            reading(broken)


def test_a_chain_inside_a_chain_is_refused() -> None:
    inside = first().narrowed(A).token
    with pytest.raises(GrantMalformed):
        VERIFIER.open(nested(unpack(inside).narrowings[0], single=inside), NOW)


def test_a_chain_may_have_64_kib_and_no_more() -> None:
    largest = nested(*[bytes(16 * 1024)] * 3, single=bytes(16 * 1024 - 14))
    assert len(largest) == 64 * 1024
    assert len(unpack(largest).narrowings) == 3
    with pytest.raises(GrantMalformed, match="not a chain"):
        pack_chain(bytes(16 * 1024), [bytes(16 * 1024)] * 3)
