"""The grant document: round trips, and every trap refused by name."""

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given, settings
from hypothesis import strategies as st

from ca.encoding import decode, encode
from ca.publickey import thumbprint
from ca.signer import KeySigner
from grants import document
from grants.errors import (
    ConditionRefused,
    GrantExpired,
    GrantForged,
    GrantMalformed,
    GrantNotYetValid,
)
from grants.model import ALL_RIGHTS, Permission, Restriction, Right, filter_rules
from tests.grants.authority import (
    CA,
    COARSE,
    DRAFT,
    NOW,
    OTHER_CA,
    draft,
    granted,
    signed_claims,
)

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


def test_round_trip() -> None:
    grant = document.open_grant(DATA, CA.public_key, NOW, domain="home")
    for name, value in vars(DRAFT).items():
        assert getattr(grant, name) == value
    assert grant == document.peek(DATA)
    assert grant.id == document.grant_id(DATA)
    assert grant.issuer == thumbprint(CA.public_key)
    assert grant.short_id == grant.id.hex()[:8]


def test_all_shapes_round_trip() -> None:
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


def test_the_id_is_what_the_specification_says() -> None:
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


def test_every_prefix_and_tail_is_refused() -> None:
    for end in range(len(DATA)):
        with pytest.raises((GrantForged, GrantMalformed)):
            opened(DATA[:end])
    with pytest.raises(GrantMalformed):
        opened(DATA + b"\0")


def test_another_authority() -> None:
    with pytest.raises(GrantForged, match="not a grant of this authority"):
        document.open_grant(DATA, OTHER_CA.public_key, NOW)


def test_in_the_name_of_another_authority() -> None:
    claims = document.GRANT.peek(document.sign(OTHER_CA, DRAFT))
    with pytest.raises(GrantForged, match="in the name of another"):
        opened(signed_claims(claims))


def test_another_trust_domain() -> None:
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
def test_time(now: int, error: type[Exception]) -> None:
    with pytest.raises(error):
        document.open_grant(DATA, CA.public_key, now)
    document.open_grant(DATA, CA.public_key, DRAFT.not_before)
    document.open_grant(DATA, CA.public_key, DRAFT.expires - 1)


def resign(protected: bytes, body: bytes, unprotected: bytes = b"\xa0") -> bytes:
    """A COSE_Sign1 whose signature is good, whatever is in it."""
    signature = CA.sign(encode(["Signature1", protected, b"", body]))
    return b"\xd2\x84" + encode(protected) + unprotected + encode(body) + encode(signature)


PROTECTED = document.GRANT.protected
BODY: bytes = parts()[2]
FRAMES = {
    "unprotected header": (resign(PROTECTED, BODY, b"\xa1\x04\x41\x00"), GrantForged),
    "unknown crit": (
        resign(encode({1: -7, 2: [16, 99], 16: "rossec-grant+cwt", 99: 1}), BODY),
        GrantForged,
    ),
    "other type": (resign(encode({1: -7, 2: [16], 16: "rossec-ticket+cwt"}), BODY), GrantForged),
    "other algorithm": (
        resign(encode({1: -8, 2: [16], 16: "rossec-grant+cwt"}), BODY),
        GrantForged,
    ),
    "duplicate key": (resign(PROTECTED, b"\xaa\x02\x62/a" + BODY[1:]), GrantMalformed),
    "long integer": (
        resign(PROTECTED, BODY.replace(b"\x04\x1a", b"\x04\x1b\0\0\0\0", 1)),
        GrantMalformed,
    ),
    "trailing bytes in the payload": (resign(PROTECTED, BODY + b"\0"), GrantMalformed),
    "indefinite length": (resign(PROTECTED, b"\xbf" + BODY[1:] + b"\xff"), GrantMalformed),
    "no tag": (DATA[1:], GrantForged),
    "long array header": (b"\xd2\x98\x04" + DATA[2:], GrantMalformed),
    "too large": (resign(PROTECTED, BODY + bytes(17000)), GrantMalformed),
    "empty": (b"", GrantForged),
}


@pytest.mark.parametrize("name", FRAMES)
def test_frames(name: str) -> None:
    data, error = FRAMES[name]
    with pytest.raises(error):
        opened(data)
    with pytest.raises(GrantMalformed, match="not a grant"):
        document.peek(data)
    with pytest.raises(GrantMalformed, match="not a grant"):
        document.grant_id(data)


def scope(*entries: Any) -> Callable[[Any], Any]:
    return lambda claims: claims | {9: encode(list(entries))}


def restricted(restriction: Any) -> Callable[[Any], Any]:
    return scope(["/a", 2, restriction])


def without(key: int) -> Callable[[Any], Any]:
    return lambda claims: {name: value for name, value in claims.items() if name != key}


def put(key: int | str, value: Any) -> Callable[[Any], Any]:
    return lambda claims: claims | {key: value}


TYPE, URI = "a/B", "urn:ietf:params:oauth:ckt:sha-256:"
CLAIMS: dict[str, tuple[Callable[[Any], Any], str]] = {
    "sibling claim": (put(-70000, {"filters": 1}), "unknown claim -70000"),
    "sibling claim with a text key": (put("filters", 1), "unknown claim filters"),
    "not a map": (lambda claims: [claims], "not a map"),
    "missing exp": (without(4), "claim 4 is missing"),
    "missing cnf": (without(8), "claim 8 is missing"),
    "missing cap": (without(-65537), "claim -65537 is missing"),
    "iat": (put(6, 1), "unknown claim 6"),
    "exp is text": (put(4, "never"), "exp of a grant is of a wrong type"),
    "exp is true": (put(4, True), "exp of a grant is of a wrong type"),
    "exp is a float": (put(4, 1.5e9), "exp of a grant is of a wrong type"),
    "exp before nbf": (put(4, 1), "not_before < expires <= cap"),
    "cap before exp": (put(-65537, NOW), "not_before < expires <= cap"),
    "cap beyond time": (put(-65537, 1 << 60), "not_before < expires <= cap"),
    "negative nbf": (put(5, -1), "not_before < expires <= cap"),
    "short serial": (put(7, b"1"), "serial 16"),
    "short holder": (put(8, {5: b"1"}), "holder must be 32 bytes"),
    "holder key": (put(8, {1: {1: 2}}), "unknown confirmation 1"),
    "holder and more": (put(8, {5: bytes(32), 3: b"kid"}), "unknown confirmation 3"),
    "relative subject": (put(2, "heating"), "not an absolute ROS name"),
    "subject is bytes": (put(2, b"/heating"), "sub of a grant"),
    "no domain": (put(3, ""), "trust domain"),
    "iss is bytes": (put(1, bytes(32)), "iss of a grant"),
    "iss is another uri": (put(1, "urn:x"), "thumbprint URI"),
    "iss is short": (put(1, URI + "AAAA"), "thumbprint URI"),
    "iss with odd last bits": (put(1, URI + "A" * 42 + "B"), "thumbprint URI"),
    "iss is not base64": (put(1, URI + "!" * 43), "thumbprint URI"),
    "scope is an array": (put(9, [["/a", 1]]), "scope of a grant"),
    "scope is a map": (put(9, encode({1: 2})), "scope of a grant"),
    "scope is not strict": (put(9, b"\x98\x00"), "in a grant"),
    "empty scope": (scope(), "permits nothing"),
    "entry is a map": (scope({1: 2}), "not .pattern, rights, restrictions."),
    "entry is too long": (scope(["/a", 1, {1: ["true"]}, 1]), "not .pattern"),
    "entry with null": (scope(["/a", 1, None]), "restrictions of a grant are not a map"),
    "pattern": (scope(["/a*", 1]), "not a name pattern"),
    "no right": (scope(["/a", 0]), "unknown or no right: 0"),
    "right is true": (scope(["/a", True]), "rights of a grant"),
    "unknown right bit": (scope(["/a", 257]), "unknown or no right: 257"),
    "negative right": (scope(["/a", -1]), "unknown or no right"),
    "huge right": (scope(["/a", 1 << 63]), "unknown or no right"),
    "restricted admin": (scope(["/a", 128, {1: ["true"]}]), "cannot be restricted"),
    "unknown restriction": (restricted({5: {"rate": 1}, 1: ["true"]}), "unknown restriction 5"),
    "on_stale is no word": (restricted({4: "cut", 1: ["true"]}), "on_stale of a grant is not keep"),
    "unknown limit": (restricted({3: {"delay": 1, "rate": 1}}), "unknown limit delay"),
    "empty limits": (restricted({3: {}, 1: ["true"]}), "an empty restriction"),
    "limits are a number": (restricted({3: 1}), "a restriction of a grant is of a wrong type"),
    "rate is text": (restricted({3: {"rate": "1"}}), "rate of a grant is of a wrong type"),
    "rate is true": (restricted({3: {"rate": True}}), "rate of a grant is of a wrong type"),
    "rate of nothing": (restricted({3: {"rate": 0}}), "a rate must be above zero"),
    "rate without end": (restricted({3: {"rate": float("inf")}}), "a rate must be above zero"),
    "text restriction": (restricted({"rate": 1}), "unknown restriction rate"),
    "empty restriction": (restricted({}), "restricts nothing"),
    "only a type": (restricted({0: TYPE}), "restricts nothing"),
    "empty conditions": (restricted({0: TYPE, 1: [], 2: {"x": {"clear": True}}}), "an empty"),
    "empty filters": (restricted({0: TYPE, 1: ["true"], 2: {}}), "an empty restriction"),
    "filters without type": (restricted({2: {"x": {"clear": True}}}), "without the message type"),
    "bad type": (restricted({0: "Pose", 1: ["true"]}), "not a message type"),
    "type is a number": (restricted({0: 1, 1: ["true"]}), "type of a grant"),
    "condition is a number": (restricted({1: [1]}), "a condition of a grant"),
    "conditions is text": (restricted({1: "true"}), "a restriction of a grant"),
    "empty condition": (restricted({1: [""]}), "a condition is empty"),
    "long condition": (restricted({1: ["t" * 1001]}), "a condition is empty or longer"),
    "filter is text": (restricted({0: TYPE, 2: {"x": "clear"}}), "a filter of a grant"),
    "unknown operator": (restricted({0: TYPE, 2: {"x": {"blur": True}}}), "unknown operator"),
    "unknown parameter": (
        restricted({0: TYPE, 2: {"x": {"round": {"step": 1, "half": 1}}}}),
        "expected step",
    ),
    "empty operator": (restricted({0: TYPE, 2: {"x": {}}}), "exactly one operator"),
    "bad path": (restricted({0: TYPE, 2: {"x..y": {"clear": True}}}), "not a field path"),
    "bad parameter": (restricted({0: TYPE, 2: {"x": {"round": {"step": b"1"}}}}), "parameter"),
}


@pytest.mark.parametrize("name", CLAIMS)
def test_claims(name: str) -> None:
    change, message = CLAIMS[name]
    with pytest.raises(GrantMalformed, match=message):
        opened(signed_claims(change(payload())))


def test_claims_beyond_the_usual_form() -> None:
    """Other texts, lengths and times than the quick comparison expects are read all the same."""
    far = draft(domain="zuh\u00e4use", not_before=0, expires=1 << 40, cap=1 << 41)
    assert document.open_grant(document.sign(CA, far), CA.public_key, NOW).domain == "zuh\u00e4use"


def test_what_nobody_accepts_is_not_signed() -> None:
    with pytest.raises(ConditionRefused):
        document.sign(CA, draft(Permission("/a", Right.CALL, Restriction(conditions=("1 +",)))))
    many = tuple(Permission(f"/topic{n}", Right.CALL) for n in range(2000))
    with pytest.raises(GrantMalformed, match="16384 are allowed"):
        document.sign(CA, draft(*many))


def test_a_node_key_is_no_authority() -> None:
    node = KeySigner(ec.generate_private_key(ec.SECP256R1()))
    with pytest.raises(GrantForged):
        opened(document.sign(node, DRAFT))


def test_many_grants_under_one_key() -> None:
    """The key's thumbprint is remembered for as long as the key is the same."""
    key, other = CA.public_key, OTHER_CA.public_key
    for _ in range(2):
        assert document.open_grant(DATA, key, NOW) == document.open_grant(DATA, key, NOW)
        assert document.open_grant(document.sign(OTHER_CA, DRAFT), other, NOW).domain == "home"
        with pytest.raises(GrantForged):
            document.open_grant(DATA, other, NOW)


@settings(max_examples=300)
@given(st.binary(max_size=300), st.integers(0, len(BODY)), st.integers(0, 40))
def test_fuzzed_claims_give_our_errors_or_a_grant(noise: bytes, at: int, cut: int) -> None:
    """Signed, so that the noise reaches the reader; what is read has one encoding."""
    body = BODY[:at] + noise + BODY[at + cut :]
    with suppress(GrantMalformed):
        document.peek(resign(PROTECTED, body))
        assert encode(decode(body)) == body


@given(st.binary(max_size=200))
def test_noise_gives_our_errors(noise: bytes) -> None:
    for data in (noise, DATA[:40] + noise, b"\xd2" + noise):
        with pytest.raises((GrantForged, GrantMalformed)):
            opened(data)


def test_on_stale_is_read_as_it_was_written() -> None:
    for restriction in (Restriction(keep_when_stale=True), replace(COARSE, keep_when_stale=True)):
        grant = granted(Permission("/stop", Right.SUBSCRIBE, restriction))
        assert grant.permissions[0].restriction == restriction
