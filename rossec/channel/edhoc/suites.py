"""The cipher suites of EDHOC (RFC 9528 section 3.6) as one table, and its key schedule (section 4).

`OFFERED_SUITES` is the policy; the other rows are implemented, not offered. The key exchange of a suite has
the interface of a KEM (section 9.4), so a hybrid one fits without a change to the handshake. SHA-256 and
method 0 alone: both sides sign, so PRK_2e = PRK_3e2m = PRK_4e3m. Which secret exists when is decided in
`handshake`.
Python cannot wipe bytes: secrets are dropped as early as possible, no more is promised.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import cached_property, partial
from typing import Final, Protocol, TypeAlias

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, mlkem, x25519
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.ciphers.aead import AESCCM, AESGCM, ChaCha20Poly1305
from cryptography.hazmat.primitives.hmac import HMAC
from cryptography.hazmat.primitives.kdf.hkdf import HKDF, HKDFExpand

from ca.encoding import encode, head
from rossec.errors import HandshakeFailed

PublicKey: TypeAlias = ec.EllipticCurvePublicKey | ed25519.Ed25519PublicKey
Aead: TypeAlias = AESGCM | AESCCM | ChaCha20Poly1305
Random: TypeAlias = Callable[[int], bytes]
Finish: TypeAlias = Callable[[bytes], bytes]
"""From the responder's half of an exchange to the shared secret; holds the ephemeral key."""

HASH_LENGTH: Final = 32  # SHA-256 in every suite of the table
SIGNATURE_LENGTH: Final = 64  # EdDSA and ES256 alike
HYBRID: Final = -24
_SHA256: Final = hashes.SHA256()
_ECDSA: Final = ec.ECDSA(_SHA256)
_P256_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
# CBOR's heads of short byte strings, and its small integers.
_SHORT: Final = tuple(head(0x40, length) for length in range(256))
_SMALL: Final = tuple(head(0, value) for value in range(256))


class KeyExchange(Protocol):
    """An ephemeral exchange in three steps; the first and last belong to the initiator."""

    initiator_length: int
    responder_length: int

    # What turns G_Y into the shared secret, and G_X to send.
    def start(self, random: Random) -> tuple[Finish, bytes]: ...

    # G_Y to send, and the shared secret.
    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]: ...


class X25519Exchange:
    """RFC 7748; an all-zero result is refused (RFC 9528 section 9.2), by the library and here."""

    initiator_length = 32
    responder_length = 32

    def start(self, random: Random) -> tuple[Finish, bytes]:
        key = x25519.X25519PrivateKey.from_private_bytes(random(32))
        return partial(_x25519, key), key.public_key().public_bytes_raw()

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
        finish, g_y = self.start(random)
        return g_y, finish(g_x)


_X25519: Final = X25519Exchange()


class P256Exchange:
    """ECDH with x-coordinates alone (RFC 9528 section 3.7); points off the curve are refused."""

    initiator_length = 32
    responder_length = 32

    def start(self, random: Random) -> tuple[Finish, bytes]:
        scalar = int.from_bytes(random(40)) % (_P256_ORDER - 1) + 1  # bias below 2^-64
        key = ec.derive_private_key(scalar, ec.SECP256R1())
        return partial(_p256, key), key.public_key().public_numbers().x.to_bytes(32)

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
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
        key = mlkem.MLKEM768PrivateKey.from_seed_bytes(random(64))
        finish, share = _X25519.start(random)
        # An invalid ciphertext gives a random secret (implicit rejection): the handshake fails later.
        share = key.public_key().public_bytes_raw() + share
        return lambda peer: key.decapsulate(peer[:1088]) + finish(peer[1088:]), share

    def answer(self, random: Random, g_x: bytes) -> tuple[bytes, bytes]:
        try:
            key = mlkem.MLKEM768PublicKey.from_public_bytes(g_x[:1184])
        except ValueError:
            raise HandshakeFailed("the peer's ephemeral key is not a usable ML-KEM key") from None
        secret, ciphertext = key.encapsulate()
        share, shared = _X25519.answer(random, g_x[1184:])
        return ciphertext + share, secret + shared


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

OFFERED_SUITES: Final = (6,)
"""What this release offers and accepts, in order of preference."""

POST_QUANTUM: Final = {"off": OFFERED_SUITES, "prefer": (HYBRID, 6), "require": (HYBRID,)}
"""The policies: `prefer` costs one round trip with a peer that has it `off`."""


class KdfLabel(IntEnum):
    """Labels of EDHOC_KDF (RFC 9528, figure 6)."""

    KEYSTREAM_2 = 0
    MAC_2 = 2
    K_3 = 3
    IV_3 = 4
    MAC_3 = 6
    PRK_OUT = 7
    K_4 = 8
    IV_4 = 9
    PRK_EXPORTER = 10
    KEY_UPDATE = 11


class Secret:
    # Section 4.1.2, EDHOC_Expand: HKDF-Expand.
    __slots__ = ("_hmac", "_key")

    def __init__(self, key: bytes) -> None:
        self._key = key
        self._hmac = HMAC(key, _SHA256)

    def expand(self, info: bytes, length: int) -> bytes:
        if length > HASH_LENGTH:
            return HKDFExpand(_SHA256, length, info).derive(self._key)
        block = self._hmac.copy()  # one block alone: RFC 5869 section 2.3
        block.update(info + b"\x01")
        return block.finalize()[:length]


GONE: Final = Secret(b"")


def extract(salt: bytes, secret: bytes) -> Secret:
    """EDHOC_Extract: HKDF-Extract (section 4.1.1)."""
    return Secret(HKDF.extract(_SHA256, salt, secret))


def bstr(data: bytes) -> bytes:
    """Encode a byte string: what `encode` gives, at a fifth of the cost for the usual ones."""
    length = len(data)
    if length < len(_SHORT):
        return _SHORT[length] + data
    return b"\x59" + length.to_bytes(2) + data if length < 65536 else encode(data)


def kdf(prk: Secret, label: int, context: bytes, length: int) -> bytes:
    """EDHOC_KDF (section 4.1.2)."""
    size = _SMALL[length] if length < len(_SMALL) else head(0, length)
    number = _SMALL[label] if label < len(_SMALL) else head(0, label)
    return prk.expand(number + bstr(context) + size, length)


def transcript_2(g_y: bytes, message_1: bytes) -> bytes:
    """TH_2 = H( G_Y, H(message_1) ), over the bytes as they travelled (section 5.3.2)."""
    digest = hashlib.sha256(message_1).digest()
    return hashlib.sha256(bstr(g_y) + bstr(digest)).digest()


def transcript_next(previous: bytes, plaintext: bytes, credential: bytes) -> bytes:
    """TH_3 and TH_4 = H( TH_2 or TH_3, PLAINTEXT_x, CRED_x ) (sections 5.4.2 and 5.5.2)."""
    return hashlib.sha256(bstr(previous) + plaintext + credential).digest()


@dataclass(frozen=True)
class EdhocExporter:
    """The result of a finished handshake: PRK_out, and nothing older."""

    prk_out: bytes

    @classmethod
    def derive(cls, prk_4e3m: Secret, th_4: bytes) -> "EdhocExporter":
        return cls(kdf(prk_4e3m, KdfLabel.PRK_OUT, th_4, HASH_LENGTH))  # section 4.1.3

    @cached_property
    def _prk_exporter(self) -> Secret:
        return Secret(kdf(Secret(self.prk_out), KdfLabel.PRK_EXPORTER, b"", HASH_LENGTH))

    def export(self, label: int, context: bytes, length: int) -> bytes:
        """EDHOC_Exporter (section 4.2.1)."""
        return kdf(self._prk_exporter, label, context, length)

    def bare(self) -> "EdhocExporter":
        return EdhocExporter(self.prk_out)

    def update(self, context: bytes) -> "EdhocExporter":
        """EDHOC_KeyUpdate (section 4.2.2): only forward secrecy."""
        return EdhocExporter(kdf(Secret(self.prk_out), KdfLabel.KEY_UPDATE, context, HASH_LENGTH))

    def __repr__(self) -> str:
        return "Exporter(...)"  # secrets never reach a log
