from dataclasses import replace

import pytest

from ca.enrollment.invitation import MAX_CLAIM_SIZE, InvitationCode, JoinClaim, sign_claim, sign_proof
from ca.errors import EnrollmentMessageRefused, JoinRefused
from tests.support.pki import NOW

CODE = InvitationCode(bytes(32), bytes(16), NOW, "192.168.1.7:11318", "/fleet/*")
AGREED = bytes(range(32))
METADATA = b"<node><name>lamp</name></node>"


def claim(metadata: bytes = METADATA) -> JoinClaim:
    return JoinClaim(CODE.id, AGREED, metadata, sign_claim(CODE.signer, AGREED, metadata))


def test_the_octets_as_documented() -> None:
    made = claim()
    size = len(made.proof).to_bytes(2)
    assert made.to_bytes() == CODE.id + AGREED + size + made.proof + METADATA


@pytest.mark.parametrize("made", [claim(), claim(bytes(4096)), claim(b"1")])
def test_the_same_comes_back(made: JoinClaim) -> None:
    assert JoinClaim.from_bytes(made.to_bytes()) == made
    JoinClaim.from_bytes(made.to_bytes()).verify(CODE.key)


def test_what_is_cut_short_is_refused_or_not_proved() -> None:
    data = claim().to_bytes()
    for end in range(len(data)):
        with pytest.raises((EnrollmentMessageRefused, JoinRefused)):
            JoinClaim.from_bytes(data[:end]).verify(CODE.key)
    with pytest.raises(JoinRefused):
        JoinClaim.from_bytes(data + b"\0").verify(CODE.key)


@pytest.mark.parametrize(
    "data",
    [
        bytes(MAX_CLAIM_SIZE + 1),
        bytes(66),
        bytes(64) + (513).to_bytes(2) + bytes(514),
        bytes(66) + bytes(4097),
    ],
)
def test_wrong_sizes(data: bytes) -> None:
    with pytest.raises(EnrollmentMessageRefused):
        JoinClaim.from_bytes(data)


@pytest.mark.parametrize(
    "change", [{"metadata": b"<node/>"}, {"transcript": bytes(32)}, {"proof": b""}, {"proof": b"x"}]
)
def test_the_proof_is_about_every_part(change: dict[str, bytes]) -> None:
    with pytest.raises(JoinRefused):
        replace(claim(), **change).verify(CODE.key)
    with pytest.raises(JoinRefused):
        claim().verify(replace(CODE, secret=b"1" * 16).key)


def test_the_proof_of_a_request_is_none_of_a_claim() -> None:
    proof = sign_proof(CODE.signer, AGREED, METADATA, "")
    with pytest.raises(JoinRefused):
        replace(claim(), proof=proof).verify(CODE.key)
