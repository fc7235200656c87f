"""The transcript hash of a join, and the two statements signed over it.

The transcript binds the invitation, a fresh nonce of each side, and the authority's certificates.
`/ca` signs it, which shows that this very peer has the key of `/ca` now; the node signs it together
with its request, by the key derived from the secret of the invitation. Each statement is of a kind
of its own and holds hashes that the signer computed: neither side signs what the other chooses.
"""

from collections.abc import Sequence
from hashlib import sha256
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.encoding import Value, encode
from ca.errors import JoinRefused, NotTheAuthority, SignatureError
from ca.keys.signer import Signer

MAX_STATEMENT: Final = 512
MAX_METADATA: Final = 4096  # what a node says of itself, where rules give names
_CONTEXT: Final = "rossec-join-v1"
_LIVE: Final = Profile("rossec-join-live+cbor")
_PROOF: Final = Profile("rossec-join-proof+cbor")
_CLAIM: Final = Profile("rossec-join-claim+cbor")


def transcript(
    invitation: bytes, node_nonce: bytes, own_nonce: bytes, chain: Sequence[bytes], root: bytes
) -> bytes:
    """The transcript hash of one join, 32 octets; `own_nonce` is the authority's."""
    certificates: list[Value] = [_digest(certificate) for certificate in chain]
    return _digest(
        encode([_CONTEXT, invitation, node_nonce, own_nonce, certificates, _digest(root)])
    )


def sign_live(signer: Signer, transcript_hash: bytes) -> bytes:
    """The statement of `/ca` that it takes part in this join."""
    return _LIVE.sign(signer, [transcript_hash])


def check_live(data: bytes, key: ec.EllipticCurvePublicKey, transcript_hash: bytes) -> None:
    """Return if the holder of `key` takes part in this join.

    Raises:
        NotTheAuthority: another key signed it, or it is about another join.
    """
    try:
        _LIVE.check(data, key, [transcript_hash])
    except SignatureError as error:
        raise NotTheAuthority(
            f"the peer does not have the key of the authority's node: {error}",
            "possible attacker in between: find out who answers at that address",
        ) from error


def sign_proof(
    signer: Signer, transcript_hash: bytes, csr: bytes, name: str, metadata: bytes = b""
) -> bytes:
    """The node's proof of the secret; `signer` has the key derived from it."""
    return _PROOF.sign(signer, _asked(transcript_hash, csr, name, metadata))


def check_proof(
    data: bytes,
    key: ec.EllipticCurvePublicKey,
    transcript_hash: bytes,
    csr: bytes,
    name: str,
    metadata: bytes = b"",
) -> None:
    """Return if the holder of the secret asks for `csr` in this join. It is only hashed.

    Raises:
        JoinRefused: it is not the proof.
    """
    _check(_PROOF, data, key, _asked(transcript_hash, csr, name, metadata))


def sign_claim(signer: Signer, transcript_hash: bytes, metadata: bytes) -> bytes:
    """The node's proof of the secret, to be told its name by metadata."""
    return _CLAIM.sign(signer, [transcript_hash, _digest(metadata)])


def check_claim(
    data: bytes, key: ec.EllipticCurvePublicKey, transcript_hash: bytes, metadata: bytes
) -> None:
    """Return if the holder of the secret sends `metadata`, which are only hashed.

    Raises:
        JoinRefused: it is not the proof.
    """
    _check(_CLAIM, data, key, [transcript_hash, _digest(metadata)])


def _asked(transcript_hash: bytes, csr: bytes, name: str, metadata: bytes) -> list[Value]:
    """What a proof is about; metadata only if there are some, as in version 1 without them."""
    asked: list[Value] = [transcript_hash, _digest(csr), name]
    return [*asked, _digest(metadata)] if metadata else asked


def _check(
    profile: Profile, data: bytes, key: ec.EllipticCurvePublicKey, content: list[Value]
) -> None:
    try:
        profile.check(data, key, content)
    except SignatureError as error:
        raise JoinRefused(f"the node does not prove the invitation's secret: {error}") from error


def _digest(data: bytes) -> bytes:
    return sha256(data).digest()
