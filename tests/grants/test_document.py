"""The grant document: round trips, and every known attack refused by name."""

import hashlib
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import decode, encode
from ca.keys.signing import KeySigner, thumbprint
from grants import document
from grants.errors import ConditionRefused, GrantExpired, GrantForged, GrantMalformed, GrantNotYetValid
from grants.model import ALL_RIGHTS, Permission, Restriction, Right, filter_rules
from tests.grants.authority import CA, DRAFT, NOW, OTHER_CA, draft, signed_claims

DATA = document.sign(CA, DRAFT)
ORDER = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551  # of P-256


def payload() -> Any:
    return document.GRANT.peek(DATA)


def parts(data: bytes = DATA) -> list[Any]:
    split = decode(data[1:])
    assert isinstance(split, list)
    return split


def opened(data: bytes) -> object:
    return document.open_grant(data, CA.public_key, NOW)


def test_a_grant_round_trips() -> None:
    grant = document.open_grant(DATA, CA.public_key, NOW, domain="home")
    for name, value in vars(DRAFT).items():
        assert getattr(grant, name) == value
    assert grant == document.peek(DATA)
    assert grant.id == document.grant_id(DATA)
    assert grant.issuer == thumbprint(CA.public_key)
    assert grant.short_id == grant.id.hex()[:8]


def test_grants_of_all_forms_round_trip() -> None:
    time_only = Restriction(conditions=('now < timestamp("2030-01-01T00:00:00Z")',))
    no_parameters = Restriction("a/B", (), filter_rules({"x": {"clear": True}}))
    permissions = (
        Permission("/**", ALL_RIGHTS),
        Permission("/a/*", Right.CALL, time_only),
        Permission("/b", Right.SUBSCRIBE, no_parameters),
        Permission("/c", Right.SUBSCRIBE, Restriction(rate=0.2)),
    )
    data = document.sign(CA, draft(*permissions))
    assert document.open_grant(data, CA.public_key, NOW).permissions == permissions


def test_the_id_follows_the_specification() -> None:
    protected, _, body, _ = parts()
    text = b"rossec-grant-id\0" + len(protected).to_bytes(4, "big") + protected + body
    assert document.grant_id(DATA) == hashlib.sha256(text).digest()[:16]


def test_every_tampered_byte_is_refused() -> None:
    for at in range(len(DATA)):
        for flip in (0x01, 0x80, 0xFF):
            changed = bytearray(DATA)
            changed[at] ^= flip
            with pytest.raises((GrantForged, GrantMalformed)):
                opened(bytes(changed))


def test_truncated_and_extended_grants_are_refused() -> None:
    for end in range(len(DATA)):
        with pytest.raises((GrantForged, GrantMalformed)):
            opened(DATA[:end])
    with pytest.raises(GrantMalformed):
        opened(DATA + b"\0")


def test_a_grant_of_another_authority_is_refused() -> None:
    with pytest.raises(GrantForged, match="not a grant of this authority"):
        document.open_grant(DATA, OTHER_CA.public_key, NOW)


def test_a_grant_with_another_issuer_is_refused() -> None:
    claims = document.GRANT.peek(document.sign(OTHER_CA, DRAFT))
    with pytest.raises(GrantForged, match="iss is another"):
        opened(signed_claims(claims))


def test_a_grant_for_another_trust_domain_is_refused() -> None:
    with pytest.raises(GrantForged, match="trust domain 'home', not 'work'"):
        document.open_grant(DATA, CA.public_key, NOW, domain="work")


def test_a_malleated_signature_keeps_the_id() -> None:
    protected, unprotected, body, signature = parts()
    s = ORDER - int.from_bytes(signature[32:])
    twin = b"\xd2" + encode([protected, unprotected, body, signature[:32] + s.to_bytes(32)])
    assert twin != DATA
    assert document.open_grant(twin, CA.public_key, NOW).id == document.grant_id(DATA)
    assert document.grant_id(twin) == document.grant_id(DATA)


@pytest.mark.parametrize(
    ("now", "error"),
    [
        (DRAFT.not_before - 1, GrantNotYetValid),
        (DRAFT.expires, GrantExpired),
        (DRAFT.expires + 10**9, GrantExpired),
    ],
)
def test_a_grant_outside_its_validity_is_refused(now: int, error: type[Exception]) -> None:
    with pytest.raises(error):
        document.open_grant(DATA, CA.public_key, now)
    document.open_grant(DATA, CA.public_key, DRAFT.not_before)
    document.open_grant(DATA, CA.public_key, DRAFT.expires - 1)


def resign(protected: bytes, body: bytes, unprotected: bytes = b"\xa0") -> bytes:
    """A COSE_Sign1 with a valid signature over any content."""
    signature = CA.sign(encode(["Signature1", protected, b"", body]))
    return b"\xd2\x84" + encode(protected) + unprotected + encode(body) + encode(signature)


PROTECTED = document.GRANT.protected
BODY: bytes = parts()[2]
FRAMES = {
    "unprotected header": (resign(PROTECTED, BODY, b"\xa1\x04\x41\x00"), GrantForged),
    "unknown crit": (resign(encode({1: -7, 2: [16, 99], 16: "rossec-grant+cwt", 99: 1}), BODY), GrantForged),
    "other type": (resign(encode({1: -7, 2: [16], 16: "rossec-ticket+cwt"}), BODY), GrantForged),
    "other algorithm": (resign(encode({1: -8, 2: [16], 16: "rossec-grant+cwt"}), BODY), GrantForged),
    "duplicate key": (resign(PROTECTED, b"\xaa\x02\x62/a" + BODY[1:]), GrantMalformed),
    "long integer": (resign(PROTECTED, BODY.replace(b"\x04\x1a", b"\x04\x1b\0\0\0\0", 1)), GrantMalformed),
    "trailing bytes in the payload": (resign(PROTECTED, BODY + b"\0"), GrantMalformed),
    "indefinite length": (resign(PROTECTED, b"\xbf" + BODY[1:] + b"\xff"), GrantMalformed),
    "no tag": (DATA[1:], GrantForged),
    "long array header": (b"\xd2\x98\x04" + DATA[2:], GrantMalformed),
    "too large": (resign(PROTECTED, BODY + bytes(17000)), GrantMalformed),
    "empty": (b"", GrantForged),
}


@pytest.mark.parametrize("name", FRAMES)
def test_malformed_frames_are_refused(name: str) -> None:
    data, error = FRAMES[name]
    with pytest.raises(error):
        opened(data)
    with pytest.raises(GrantMalformed, match="not a grant"):
        document.peek(data)
    with pytest.raises(GrantMalformed, match="not a grant"):
        document.grant_id(data)


def test_grants_that_verifiers_refuse_are_not_signed() -> None:
    with pytest.raises(ConditionRefused):
        document.sign(CA, draft(Permission("/a", Right.CALL, Restriction(conditions=("1 +",)))))
    many = tuple(Permission(f"/topic{n}", Right.CALL) for n in range(2000))
    with pytest.raises(GrantMalformed, match="16384 are allowed"):
        document.sign(CA, draft(*many))


def test_a_grant_signed_by_a_node_is_refused() -> None:
    node = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    with pytest.raises(GrantForged):
        opened(document.sign(node, DRAFT))


def test_many_grants_are_verified_with_one_key() -> None:
    """The thumbprint is cached as long as the key object is the same."""
    key, other = CA.public_key, OTHER_CA.public_key
    for _ in range(2):
        assert document.open_grant(DATA, key, NOW) == document.open_grant(DATA, key, NOW)
        assert document.open_grant(document.sign(OTHER_CA, DRAFT), other, NOW).domain == "home"
        with pytest.raises(GrantForged):
            document.open_grant(DATA, other, NOW)


@given(st.binary(max_size=200))
def test_random_bytes_are_refused(noise: bytes) -> None:
    for data in (noise, DATA[:40] + noise, b"\xd2" + noise):
        with pytest.raises((GrantForged, GrantMalformed)):
            opened(data)
