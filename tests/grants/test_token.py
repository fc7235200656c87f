"""Tokens: plain and renewed grants, and every kind of invalid token."""

from dataclasses import replace
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import encode
from ca.errors import Revoked
from ca.keys.publickey import thumbprint
from ca.keys.signer import KeySigner
from grants import document
from grants.decision import authorize
from grants.errors import GrantExpired, GrantMalformed, GrantRevoked, RenewalForOther
from grants.model import Right
from grants.renewal import Delegation, Ticket, sign_delegation, sign_ticket
from grants.token import TokenParts, Verifier, pack, unpack
from tests.grants.authority import CA, DRAFT, HOLDER, NOW

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
    with pytest.raises(RenewalForOther, match="the master's key is not known"):
        replace(VERIFIER, delegates=()).open(TOKEN, LATER)


def test_a_renewal_counts_from_each_master_that_is_known() -> None:
    other = ec.generate_private_key(ec.SECP256R1()).public_key()
    for keys in ((other, MASTER.public_key), (MASTER.public_key, other)):
        assert replace(VERIFIER, delegates=keys).open(TOKEN, LATER).id == ID
    with pytest.raises(RenewalForOther, match="for another key than this one"):
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
