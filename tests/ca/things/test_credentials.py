"""How a thing proves who it is: a CCS as the thing has it, or a secret that is only named."""

import hashlib

import lakers
import pytest
from cryptography.hazmat.primitives.asymmetric import ec
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import encode
from ca.errors import KeyRefused, ThingRefused
from ca.keys.signing import thumbprint
from ca.things import (
    MAX_CCS,
    ThingKey,
    ThingSecret,
    read_ccs,
    read_confirmation,
    read_description,
    read_key,
    secret_thumbprint,
    write_confirmation,
)
from tests.vectors.make_things import FLAWED_CREDENTIALS, KEY, LAMP, SECRET, cose_key

# CRED_R of RFC 9529 section 3.3 (its Appendix B gives the key), byte for byte.
RFC9529 = bytes.fromhex(
    "a2026b6578616d706c652e65647508a101a501020241322001215820bbc34960526ea4d32e940cad2a234148"
    "ddc21791a12afbcbac93622046dd44f02258204519e257236b2a0ce2023f0931f1f386ca7afda64fcde0108c"
    "224c51eabf6072"
)


def test_the_credential_of_rfc_9529_is_read() -> None:
    key = read_ccs(RFC9529)
    assert (key.kid, key.subject) == (b"\x32", "example.edu")
    assert key.ccs == RFC9529
    assert thumbprint(key.public_key) == key.thumbprint


@pytest.mark.parametrize("subject", ["", "lamp", "s" * 64])
def test_lakers_takes_every_credential_that_is_read(subject: str) -> None:
    key = ThingKey.of(LAMP.public_key, b"12345678", subject)
    assert len(key.ccs) <= MAX_CCS
    found = lakers.Credential(key.ccs)
    assert (found.kid(), found.public_key()) == (key.kid, key.coordinates[:32])
    assert read_ccs(key.ccs) == key


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("no CBOR", "not a credential of a thing"),
        ("not a map", "missing or unknown claims"),
        ("an unknown claim", "missing or unknown claims"),
        ("an empty subject", "empty, or not text"),
        ("a subject of 65 octets", "more than 64 octets"),
        ("more than 192 octets", "at most 192"),
        ("a second confirmation", "not a P-256 key"),
        ("an octet after it", "expected one CBOR item"),
        ("a number that is too long", "not in its deterministic form"),
        ("a key an empty kid", "a kid of 0 octets, 1 to 8"),
        ("a key a truth for a curve", "not a P-256 key"),
    ],
)
def test_the_reason_for_a_refusal(name: str, message: str) -> None:
    with pytest.raises(ThingRefused, match=message):
        read_ccs(FLAWED_CREDENTIALS[name])


def test_a_point_beside_the_curve_is_refused() -> None:
    with pytest.raises(KeyRefused, match=r"not a point of P-256"):
        read_ccs(FLAWED_CREDENTIALS["a key no point of the curve"])
    with pytest.raises(KeyRefused):
        ThingKey.of(ec.generate_private_key(ec.SECP384R1()).public_key(), b"1")


def test_every_part_of_a_credential_counts() -> None:
    for at in range(len(KEY.ccs)):
        with pytest.raises(ThingRefused):
            read_ccs(KEY.ccs[:at])


@given(st.binary(max_size=250))
def test_other_bytes_are_no_credential(data: bytes) -> None:
    with pytest.raises((ThingRefused, KeyRefused)):
        read_ccs(data)


def test_a_key_is_named_by_what_it_is_and_not_by_its_credential() -> None:
    assert ThingKey.of(LAMP.public_key, b"1").thumbprint == KEY.thumbprint
    assert thumbprint(LAMP.public_key) == KEY.thumbprint


def test_a_secret_is_named_by_its_thumbprint() -> None:
    known = ThingSecret.of(SECRET, b"\x07")
    assert known.matches(SECRET)
    assert not known.matches(bytes(16))
    assert not known.matches(SECRET + b"\0")
    # RFC 9679 section 5: the map {1: 4, -1: k}.
    assert secret_thumbprint(SECRET) == hashlib.sha256(b"\xa2\x01\x04\x20\x50" + SECRET).digest()
    assert SECRET not in encode(write_confirmation(known))
    with pytest.raises(ThingRefused, match="a secret of 15 octets, not of 16"):
        secret_thumbprint(bytes(15))
    with pytest.raises(ThingRefused, match="32 octets"):
        ThingSecret(b"\x07", bytes(31))


def test_a_secret_is_described_without_it() -> None:
    known = ThingSecret.of(SECRET, b"\x07")
    assert read_description(known.description) == known
    assert SECRET not in known.description
    flawed = (b"", SECRET, KEY.ccs, known.description + b"\0", encode({8: {3: 7, 5: bytes(32)}}))
    for data in (*flawed, encode({8: {3: b"\x07", 5: bytes(31)}}), encode({2: "a", 8: {}})):
        with pytest.raises(ThingRefused):
            read_description(data)
    with pytest.raises(ThingRefused, match="description of a secret") as caught:
        read_description(SECRET)
    assert "rossec border add NAME --psk" in caught.value.hint


def test_what_is_written_is_read() -> None:
    for credential in (KEY, ThingSecret.of(SECRET, b"\x07")):
        subject = credential.subject if isinstance(credential, ThingKey) else ""
        assert read_confirmation(write_confirmation(credential), subject) == credential
    with pytest.raises(ThingRefused, match="a secret has no subject"):
        read_confirmation(write_confirmation(ThingSecret.of(SECRET, b"\x07")), "lamp")
    with pytest.raises(ThingRefused):
        read_key([cose_key()], "")
