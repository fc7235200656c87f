"""The transcript hash of an enrollment, and the statements, tag and digits computed from it.

The transcript binds request, certificates, trust anchor and a fresh nonce, under its own context:
nothing signed here can be replayed in a later enrollment or taken for another statement, and no
peer can choose the octets that a node signs. The six digits also depend on `contribution`, random
octets the node reveals only *after* the offer is fixed: otherwise an attacker posing as the
authority could try a million nonces until the digits match.
"""

import hmac
from collections.abc import Sequence
from hashlib import sha256
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.encoding import encode
from ca.enrollment import NONCE_SIZE
from ca.errors import AcknowledgementRefused, EncodingError, SignatureError
from ca.keys.signer import Signer

_CONTEXT: Final = "rossec-enroll-v1"
_OFFER: Final = "rossec-enroll-offer-v1"
_DIGITS: Final = "rossec-enroll-digits-v1"
_ACKNOWLEDGEMENT: Final = Profile("rossec-enroll-ack+cbor")
_DONE: Final = Profile("rossec-enroll-done+cbor")
_MAX_STATEMENT: Final = 512


def transcript(csr: bytes, chain: Sequence[bytes], root: bytes, nonce: bytes) -> bytes:
    """The transcript hash of one enrollment, 32 octets."""
    certificates = [_digest(certificate) for certificate in chain]
    return _digest(encode([_CONTEXT, _digest(csr), [*certificates], _digest(root), nonce]))


def tag(secret: bytes, transcript_hash: bytes) -> bytes:
    """The MAC of an offer: it proves that the sender has read the code."""
    return hmac.digest(secret, encode([_OFFER, transcript_hash]), "sha256")


def verify_tag(secret: bytes, transcript_hash: bytes, given: bytes) -> bool:
    """Whether `given` is the tag of the offer."""
    return hmac.compare_digest(tag(secret, transcript_hash), given)


def digits(transcript_hash: bytes, contribution: bytes) -> str:
    """The six digits both sides show."""
    number = int.from_bytes(_digest(encode([_DIGITS, transcript_hash, contribution]))[:8])
    return f"{number % 1_000_000:06}"


def group_digits(six: str) -> str:
    """The digits in two groups: `123 456`."""
    return f"{six[:3]} {six[3:]}"


def sign_acknowledgement(signer: Signer, transcript_hash: bytes, contribution: bytes) -> bytes:
    """The node's signed acknowledgement of an offer."""
    return _ACKNOWLEDGEMENT.sign(signer, [transcript_hash, contribution])


def open_acknowledgement(
    data: bytes, key: ec.EllipticCurvePublicKey, transcript_hash: bytes
) -> bytes:
    """The contribution in a node's acknowledgement of the offer with this transcript hash.

    Raises:
        AcknowledgementRefused: another key signed it, or it is about another offer.
    """
    match _open(_ACKNOWLEDGEMENT, data, key):
        case [bytes() as acknowledged, bytes() as contribution] if (
            acknowledged == transcript_hash and len(contribution) == NONCE_SIZE
        ):
            return contribution
        case _:
            raise _replayed()


def sign_done(signer: Signer, transcript_hash: bytes) -> bytes:
    """The node's signed statement that it is enrolled."""
    return _DONE.sign(signer, [transcript_hash])


def check_done(data: bytes, key: ec.EllipticCurvePublicKey, transcript_hash: bytes) -> None:
    """Return if `data` is the node's statement that it is enrolled with this transcript.

    Raises:
        AcknowledgementRefused: another key signed it, or it is about another offer.
    """
    if _open(_DONE, data, key) != [transcript_hash]:
        raise _replayed()


def _open(profile: Profile, data: bytes, key: ec.EllipticCurvePublicKey) -> object:
    try:
        return profile.open(data, key, limit=_MAX_STATEMENT)
    except (SignatureError, EncodingError) as error:
        raise AcknowledgementRefused(
            f"the answer is not signed by the node: {error}",
            "possible attacker in between: start again",
        ) from error


def _replayed() -> AcknowledgementRefused:
    return AcknowledgementRefused(
        "the node's answer is for another offer",
        "it was replayed, or there was a second offer: do not confirm at the node, start again",
    )


def _digest(data: bytes) -> bytes:
    return sha256(data).digest()
