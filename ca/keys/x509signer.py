"""Let `cryptography`'s X.509 builders sign with a `Signer`.

The builders require one of the library's private key classes; a subclass that forwards `sign` is
enough. It does not have the key: everything but signing is refused, also for tokens.
"""

from typing import NoReturn, TypeAlias

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    KeySerializationEncryption,
    PrivateFormat,
)

from ca.keys.signer import Signer

Buffer: TypeAlias = bytes | bytearray | memoryview


class X509Signer(ec.EllipticCurvePrivateKey):
    """A P-256 private key for the builders of `cryptography.x509`, over a `Signer`."""

    def __init__(self, signer: Signer) -> None:
        self._signer = signer

    def sign(self, data: Buffer, signature_algorithm: ec.EllipticCurveSignatureAlgorithm) -> bytes:
        """ECDSA with SHA-256 over `data`, in DER; any other algorithm is a `TypeError`."""
        algorithm = signature_algorithm.algorithm
        if not isinstance(algorithm, hashes.SHA256):
            raise TypeError("a Signer signs with SHA-256 only")
        raw = self._signer.sign(bytes(data))
        return encode_dss_signature(int.from_bytes(raw[:32]), int.from_bytes(raw[32:]))

    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The public key."""
        return self._signer.public_key

    @property
    def curve(self) -> ec.EllipticCurve:
        """P-256."""
        return ec.SECP256R1()

    @property
    def key_size(self) -> int:
        """256 bits."""
        return 256

    def exchange(self, algorithm: ec.ECDH, peer_public_key: ec.EllipticCurvePublicKey) -> NoReturn:
        """Refused: a `Signer` only signs."""
        raise NotImplementedError("a Signer only signs")

    def private_numbers(self) -> NoReturn:
        """Refused: a `Signer` does not expose its key."""
        raise NotImplementedError("a Signer does not expose its key")

    def private_bytes(
        self,
        encoding: Encoding,
        format: PrivateFormat,  # noqa: A002  (the name the library gave it)
        encryption_algorithm: KeySerializationEncryption,
    ) -> NoReturn:
        """Refused: a `Signer` does not expose its key."""
        raise NotImplementedError("a Signer does not expose its key")

    def __copy__(self) -> "X509Signer":
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> "X509Signer":
        return self
