"""The cipher suites of EDHOC (RFC 9528 section 3.6) as one table.

Nothing here decides which suite to use: `PRODUCTION` is the policy, the other rows of the table are
implemented, not offered. The key exchange of a suite has the interface of a KEM (RFC 9528 section
9.4), so a hybrid one fits without a change to the handshake.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol, TypeAlias

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, mlkem, x25519
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.ciphers.aead import AESCCM, AESGCM, ChaCha20Poly1305

from rossec.errors import HandshakeFailed

PublicKey: TypeAlias = ec.EllipticCurvePublicKey | ed25519.Ed25519PublicKey
Aead: TypeAlias = AESGCM | AESCCM | ChaCha20Poly1305
Random: TypeAlias = Callable[[int], bytes]
Finish: TypeAlias = Callable[[bytes], bytes]
"""From the responder's half of an exchange to the shared secret; holds the ephemeral key."""

HASH_LENGTH: Final = 32  # SHA-256 in every suite of the table
HYBRID: Final = -24
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_P256_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
SIGNATURE_LENGTH: Final = 64  # EdDSA and ES256 alike


class KeyExchange(Protocol):
    """An ephemeral exchange in three steps; the first and last belong to the initiator.

    Raises:
        HandshakeFailed: from the later two, when the peer's half is not usable.
    """

    initiator_length: int
    responder_length: int

    def start(self, random: Random) -> tuple[Finish, bytes]:
        """Return what turns G_Y into the shared secret, and G_X to send."""
        ...

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
        """Return G_Y to send and the shared secret."""
        ...


class X25519Exchange:
    """RFC 7748; an all-zero result is refused (RFC 9528 section 9.2), by the library and here."""

    initiator_length = 32
    responder_length = 32

    def start(self, random: Random) -> tuple[Finish, bytes]:
        """Return what finishes the exchange, and G_X."""
        key = x25519.X25519PrivateKey.from_private_bytes(random(32))
        return partial(_x25519, key), key.public_key().public_bytes_raw()

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
        """Return G_Y and the shared secret."""
        finish, g_y = self.start(random)
        return g_y, finish(g_x)


_X25519: Final = X25519Exchange()


class P256Exchange:
    """ECDH with x-coordinates alone (RFC 9528 section 3.7); points off the curve are refused."""

    initiator_length = 32
    responder_length = 32

    def start(self, random: Random) -> tuple[Finish, bytes]:
        """Return what finishes the exchange, and G_X."""
        scalar = int.from_bytes(random(40)) % (_P256_ORDER - 1) + 1  # bias below 2^-64
        key = ec.derive_private_key(scalar, ec.SECP256R1())
        return partial(_p256, key), key.public_key().public_numbers().x.to_bytes(32)

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
        """Return G_Y and the shared secret."""
        finish, g_y = self.start(random)
        return g_y, finish(g_x)


class HybridExchange:
    """X25519 and ML-KEM-768 together: as strong as the stronger one.

    Shares and secret are concatenated as in TLS's X25519MLKEM768 (draft-ietf-tls-ecdhe-mlkem):
    ek || x25519, ct || x25519, ss || x25519. EDHOC hashes both shares into the salt of the
    extraction, which that construction relies on. ML-KEM uses its own randomness: pyca takes none.
    """

    initiator_length = 1184 + 32
    responder_length = 1088 + 32

    def start(self, random: Random) -> tuple[Finish, bytes]:
        """Return what finishes the exchange, and G_X."""
        key = mlkem.MLKEM768PrivateKey.from_seed_bytes(random(64))
        finish, share = _X25519.start(random)
        return partial(_hybrid, key, finish), key.public_key().public_bytes_raw() + share

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
        """Return G_Y and the shared secret."""
        try:
            key = mlkem.MLKEM768PublicKey.from_public_bytes(g_x[:1184])
        except ValueError:
            raise HandshakeFailed("the peer's ephemeral key is not a usable ML-KEM key") from None
        secret, ciphertext = key.encapsulate()
        share, shared = _X25519.answer(random, g_x[1184:])
        return ciphertext + share, secret + shared


def _hybrid(own: mlkem.MLKEM768PrivateKey, finish: Finish, peer: bytes) -> bytes:
    # An invalid ciphertext gives a random secret (implicit rejection): the handshake fails later.
    return own.decapsulate(peer[:1088]) + finish(peer[1088:])


def _p256(own: ec.EllipticCurvePrivateKey, peer: bytes) -> bytes:
    try:
        point = ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x02" + peer)
    except ValueError:
        raise HandshakeFailed("the peer's ephemeral key is not a usable point") from None
    return own.exchange(ec.ECDH(), point)


def _x25519(own: x25519.X25519PrivateKey, peer: bytes) -> bytes:
    try:
        return own.exchange(x25519.X25519PublicKey.from_public_bytes(peer))
    except ValueError:
        raise HandshakeFailed("the peer's ephemeral key is not a usable point") from None


def verify_es256(key: PublicKey, signature: bytes, message: bytes) -> None:
    """Verify r || s (RFC 9053 section 2.1); raise `HandshakeFailed`."""
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise HandshakeFailed("the peer's key is not a P-256 key")
    r, s = int.from_bytes(signature[:32]), int.from_bytes(signature[32:])
    try:
        key.verify(encode_dss_signature(r, s), message, _ECDSA)
    except InvalidSignature:
        raise HandshakeFailed("the peer's signature does not verify") from None


def verify_eddsa(key: PublicKey, signature: bytes, message: bytes) -> None:
    """Verify Ed25519 (RFC 8032); raise `HandshakeFailed`."""
    if not isinstance(key, ed25519.Ed25519PublicKey):
        raise HandshakeFailed("the peer's key is not an Ed25519 key")
    try:
        key.verify(signature, message)
    except InvalidSignature:
        raise HandshakeFailed("the peer's signature does not verify") from None


@dataclass(frozen=True)
class Suite:
    """One row. The EDHOC AEAD and the application AEAD are the same in every row we have."""

    number: int
    aead: Callable[[bytes], Aead]
    key_length: int
    nonce_length: int
    tag_length: int
    exchange: KeyExchange
    verify: Callable[[PublicKey, bytes, bytes], None]


def _ccm_64(key: bytes) -> AESCCM:
    return AESCCM(key, tag_length=8)


SUITES: Final = {
    suite.number: suite
    for suite in (
        # AES-CCM-16-64-128: for the vectors of RFC 9529; 64-bit tags are no production choice.
        Suite(0, _ccm_64, 16, 13, 8, _X25519, verify_eddsa),
        # The same over P-256: for lakers, another implementation, in tests.
        Suite(2, _ccm_64, 16, 13, 8, P256Exchange(), verify_es256),
        Suite(4, ChaCha20Poly1305, 32, 12, 16, _X25519, verify_eddsa),
        Suite(6, AESGCM, 16, 12, 16, _X25519, verify_es256),
        # Private use (RFC 9528 section 10.2): AES-256-GCM, because Grover halves key lengths.
        Suite(HYBRID, AESGCM, 32, 12, 16, HybridExchange(), verify_es256),
    )
}

PRODUCTION: Final = (6,)
"""What this release offers and accepts, in order of preference."""

POST_QUANTUM: Final = {"off": PRODUCTION, "prefer": (HYBRID, 6), "require": (HYBRID,)}
"""The policies: `prefer` costs one round trip with a peer that has it `off`."""
