from hashlib import sha256

import pytest

from ca.encoding import Value, encode
from ca.enrollment.invitation import (
    MAX_STATEMENT,
    check_claim,
    check_live,
    check_proof,
    sign_claim,
    sign_live,
    sign_proof,
    transcript,
)
from ca.errors import EnrollmentRefused, JoinRefused
from ca.keys.signing import Profile
from tests.support import refusal_texts
from tests.support.pki import new_signer

ID, ONE, TWO = bytes(32), b"1" * 16, b"2" * 16
KEY, OTHER = new_signer(), new_signer()
AGREED = transcript(ID, ONE, TWO, [b"leaf"], b"root")


def digest(data: bytes) -> bytes:
    return sha256(data).digest()


def test_the_transcript_as_specified() -> None:
    parts: list[Value] = ["rossec-join-v1", ID, ONE, TWO, [digest(b"leaf")], digest(b"root")]
    assert digest(encode(parts)) == AGREED


def test_every_part_counts_and_none_can_be_moved() -> None:
    found = {
        AGREED,
        transcript(bytes(31) + b"1", ONE, TWO, [b"leaf"], b"root"),
        transcript(ID, TWO, ONE, [b"leaf"], b"root"),
        transcript(ID, ONE, ONE, [b"leaf"], b"root"),
        transcript(ID, ONE, TWO, [b"leaf", b"root"], b"root"),
        transcript(ID, ONE, TWO, [b"root"], b"leaf"),
    }
    assert len(found) == 6


def test_the_authority_is_live_in_one_join() -> None:
    statement = sign_live(KEY, AGREED)
    check_live(statement, KEY.public_key, AGREED)
    assert Profile("rossec-join-live+cbor").open(statement, KEY.public_key) == [AGREED]
    for data, key, about in (
        (statement, OTHER.public_key, AGREED),
        (statement, KEY.public_key, digest(AGREED)),
        (statement[:-1], KEY.public_key, AGREED),
        (statement + b"\0", KEY.public_key, AGREED),
        (b"", KEY.public_key, AGREED),
        (sign_proof(KEY, AGREED, b"csr", "/a"), KEY.public_key, AGREED),
    ):
        with pytest.raises(EnrollmentRefused, match=refusal_texts.NOT_THE_AUTHORITY):
            check_live(data, key, about)


def test_the_proof_is_about_one_request_of_one_name_in_one_join() -> None:
    proof = sign_proof(KEY, AGREED, b"csr", "/robot")
    check_proof(proof, KEY.public_key, AGREED, b"csr", "/robot")
    opened = Profile("rossec-join-proof+cbor").open(proof, KEY.public_key)
    assert opened == [AGREED, digest(b"csr"), "/robot"]
    for data, key, about, csr, name in (
        (proof, OTHER.public_key, AGREED, b"csr", "/robot"),
        (proof, KEY.public_key, digest(AGREED), b"csr", "/robot"),
        (proof, KEY.public_key, AGREED, b"other", "/robot"),
        (proof, KEY.public_key, AGREED, b"csr", "/robot2"),
        (proof[:-1], KEY.public_key, AGREED, b"csr", "/robot"),
        (sign_live(KEY, AGREED), KEY.public_key, AGREED, b"csr", "/robot"),
    ):
        with pytest.raises(JoinRefused):
            check_proof(data, key, about, csr, name)


def test_the_longest_name_fits() -> None:
    assert len(sign_proof(KEY, AGREED, b"", "/" + "a" * 254)) <= MAX_STATEMENT


def test_a_claim_is_about_its_metadata_in_one_join() -> None:
    statement = sign_claim(KEY, AGREED, b"<node/>")
    check_claim(statement, KEY.public_key, AGREED, b"<node/>")
    content = [AGREED, digest(b"<node/>")]
    assert Profile("rossec-join-claim+cbor").open(statement, KEY.public_key) == content
    for data, agreed, metadata in (
        (statement, digest(AGREED), b"<node/>"),
        (statement, AGREED, b"<node />"),
        (sign_proof(KEY, AGREED, b"<node/>", ""), AGREED, b"<node/>"),
    ):
        with pytest.raises(JoinRefused):
            check_claim(data, KEY.public_key, agreed, metadata)


def test_a_proof_is_about_its_metadata_too() -> None:
    statement = sign_proof(KEY, AGREED, b"csr", "/a", b"<node/>")
    check_proof(statement, KEY.public_key, AGREED, b"csr", "/a", b"<node/>")
    content = [AGREED, digest(b"csr"), "/a", digest(b"<node/>")]
    assert Profile("rossec-join-proof+cbor").open(statement, KEY.public_key) == content
    for metadata in (b"", b"<node />"):
        with pytest.raises(JoinRefused):
            check_proof(statement, KEY.public_key, AGREED, b"csr", "/a", metadata)
