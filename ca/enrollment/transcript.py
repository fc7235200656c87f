"""What both sides sign, prove and compare: one hash over everything that was agreed on.

The transcript binds request, certificates, trust anchor and a fresh nonce, under a context of its
own: nothing signed here can be replayed at a later enrollment, nor taken for another statement, and
nobody can choose octets that a node signs. The six digits also depend on `contribution`, random
octets the node reveals only *after* the offer is fixed: otherwise whoever poses as the authority
would try a million nonces until the digits agree.
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
    """The hash of one enrollment, 32 octets."""
    certificates = [_digest(certificate) for certificate in chain]
    return _digest(encode([_CONTEXT, _digest(csr), [*certificates], _digest(root), nonce]))


def tag(secret: bytes, agreed: bytes) -> bytes:
    """Proof of whoever offers `agreed` (a transcript) that it has seen the code."""
    return hmac.digest(secret, encode([_OFFER, agreed]), "sha256")


def verify_tag(secret: bytes, agreed: bytes, given: bytes) -> bool:
    """Whether `given` is the proof."""
    return hmac.compare_digest(tag(secret, agreed), given)


def digits(agreed: bytes, contribution: bytes) -> str:
    """The six digits both sides show."""
    number = int.from_bytes(_digest(encode([_DIGITS, agreed, contribution]))[:8])
    return f"{number % 1_000_000:06}"


def grouped(six: str) -> str:
    """The digits for people: `123 456`."""
    return f"{six[:3]} {six[3:]}"


def acknowledge(signer: Signer, agreed: bytes, contribution: bytes) -> bytes:
    """The node's signed answer to an offer."""
    return _ACKNOWLEDGEMENT.sign(signer, [agreed, contribution])


def open_acknowledgement(data: bytes, key: ec.EllipticCurvePublicKey, agreed: bytes) -> bytes:
    """The contribution in a node's answer to the offer `agreed`.

    Raises:
        AcknowledgementRefused: another key signed it, or it is about another offer.
    """
    match _open(_ACKNOWLEDGEMENT, data, key):
        case [bytes() as about, bytes() as contribution] if (
            about == agreed and len(contribution) == NONCE_SIZE
        ):
            return contribution
        case _:
            raise _replayed()


def finish(signer: Signer, agreed: bytes) -> bytes:
    """The node's signed word that it is enrolled."""
    return _DONE.sign(signer, [agreed])


def check_done(data: bytes, key: ec.EllipticCurvePublicKey, agreed: bytes) -> None:
    """Return if the node says that it is enrolled with `agreed`.

    Raises:
        AcknowledgementRefused: another key signed it, or it is about another offer.
    """
    if _open(_DONE, data, key) != [agreed]:
        raise _replayed()


def _open(profile: Profile, data: bytes, key: ec.EllipticCurvePublicKey) -> object:
    try:
        return profile.open(data, key, limit=_MAX_STATEMENT)
    except (SignatureError, EncodingError) as error:
        raise AcknowledgementRefused(
            f"the answer is not signed by the node: {error}", "somebody is between you: start again"
        ) from error


def _replayed() -> AcknowledgementRefused:
    return AcknowledgementRefused(
        "the node's answer is about another offer than this one",
        "somebody replayed it or made an offer too: do not confirm at the node, start again",
    )


def _digest(data: bytes) -> bytes:
    return sha256(data).digest()
