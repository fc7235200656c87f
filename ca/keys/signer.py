"""The interface of a private key: a `Signer` signs, and does not expose the key.

Keys in files and in PKCS#11 tokens have the same interface.
"""

from typing import Final, Protocol

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature

_COORDINATE: Final = 32
_ES256: Final = ec.ECDSA(hashes.SHA256())


class Signer(Protocol):
    """A P-256 private key, in memory or in a token."""

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The public key."""
        ...

    def sign(self, message: bytes) -> bytes:
        """ES256 over `message`: 64 bytes, r || s (RFC 9053 section 2.1)."""
        ...


class KeySigner:
    """A `Signer` for a P-256 key in memory."""

    __slots__ = ("_key",)

    def __init__(self, key: ec.EllipticCurvePrivateKey) -> None:
        self._key = key

    @property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The public key."""
        return self._key.public_key()

    def sign(self, message: bytes) -> bytes:
        """ES256 over `message`: 64 bytes, r || s (RFC 9053 section 2.1)."""
        r, s = decode_dss_signature(self._key.sign(message, _ES256))
        return r.to_bytes(_COORDINATE) + s.to_bytes(_COORDINATE)
