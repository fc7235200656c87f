import hashlib
import hmac

import pytest

from ca.encoding import encode
from ca.enrollment import sides as t
from ca.errors import EnrollmentRefused
from tests.support.pki import new_signer

CSR, LEAF, MIDDLE, ROOT, NONCE = b"csr", b"leaf", b"middle", b"root", bytes(16)
AGREED = t.transcript(CSR, [LEAF], ROOT, NONCE)
CONTRIBUTION = b"c" * 16
SIGNER = new_signer()


def digest(data: bytes) -> bytes:
    return hashlib.sha256(data).digest()


def test_the_transcript_as_specified() -> None:
    parts = encode(["rossec-enroll-v1", digest(CSR), [digest(LEAF)], digest(ROOT), NONCE])
    assert digest(parts) == AGREED


def test_every_part_counts_and_none_can_be_moved() -> None:
    others = [
        t.transcript(b"csr2", [LEAF], ROOT, NONCE),
        t.transcript(CSR, [LEAF, MIDDLE], ROOT, NONCE),
        t.transcript(CSR, [MIDDLE], ROOT, NONCE),
        t.transcript(CSR, [LEAF], MIDDLE, NONCE),
        t.transcript(CSR, [LEAF], ROOT, b"n" * 16),
        t.transcript(LEAF, [CSR], ROOT, NONCE),
    ]
    assert len({AGREED, *others}) == 7


def test_the_tag_as_specified() -> None:
    secret = b"s" * 16
    expected = hmac.digest(secret, encode(["rossec-enroll-offer-v1", AGREED]), "sha256")
    assert t.tag(secret, AGREED) == expected
    assert t.verify_tag(secret, AGREED, expected)
    assert not t.verify_tag(secret, AGREED, b"")
    assert not t.verify_tag(bytes(16), AGREED, expected)


def test_the_digits_as_specified() -> None:
    number = int.from_bytes(digest(encode(["rossec-enroll-digits-v1", AGREED, CONTRIBUTION]))[:8])
    assert t.digits(AGREED, CONTRIBUTION) == str(number % 10**6).zfill(6)
    assert len({t.digits(AGREED, bytes([n]) * 16) for n in range(50)}) > 45
    assert t.group_digits("012345") == "012 345"


def test_an_acknowledgement_is_about_one_offer() -> None:
    statement = t.sign_acknowledgement(SIGNER, AGREED, CONTRIBUTION)
    assert t.open_acknowledgement(statement, SIGNER.public_key, AGREED) == CONTRIBUTION
    with pytest.raises(EnrollmentRefused, match="for another offer") as caught:
        t.open_acknowledgement(statement, SIGNER.public_key, bytes(32))
    assert "do not confirm" in caught.value.hint
    with pytest.raises(EnrollmentRefused, match="not signed by the node"):
        t.open_acknowledgement(statement, new_signer().public_key, AGREED)
    with pytest.raises(EnrollmentRefused, match="not signed by the node"):
        t.open_acknowledgement(b"\xa0", SIGNER.public_key, AGREED)
    short = t.sign_acknowledgement(SIGNER, AGREED, b"c")
    with pytest.raises(EnrollmentRefused, match="for another offer"):
        t.open_acknowledgement(short, SIGNER.public_key, AGREED)


def test_the_last_word_is_about_one_offer() -> None:
    statement = t.sign_done(SIGNER, AGREED)
    t.check_done(statement, SIGNER.public_key, AGREED)
    with pytest.raises(EnrollmentRefused, match="for another offer"):
        t.check_done(statement, SIGNER.public_key, bytes(32))


def test_one_statement_is_never_taken_for_the_other() -> None:
    with pytest.raises(EnrollmentRefused, match="not a statement of kind"):
        t.check_done(t.sign_acknowledgement(SIGNER, AGREED, CONTRIBUTION), SIGNER.public_key, AGREED)
    with pytest.raises(EnrollmentRefused, match="not a statement of kind"):
        t.open_acknowledgement(t.sign_done(SIGNER, AGREED), SIGNER.public_key, AGREED)
