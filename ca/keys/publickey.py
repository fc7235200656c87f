"""P-256 public keys, the only ones accepted, and their thumbprints.

Keys are identified by their COSE thumbprint (RFC 9679): grants, lists and logs refer to the key,
not to one of its certificates. A renewed certificate keeps its grants, a revoked key loses all.
"""

import hashlib
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from ca.errors import KeyRefused

THUMBPRINT_SIZE: Final = 32
_COORDINATE: Final = 32

# The deterministic COSE_Key {1: 2 (EC2), -1: 1 (P-256), -2: x, -3: y} has a fixed shape.
_HEAD: Final = bytes.fromhex("a40102200121 5820")
_BETWEEN: Final = bytes.fromhex("225820")


def require_p256(key: object) -> ec.EllipticCurvePublicKey:
    """Return `key` if it is a P-256 public key.

    Raises:
        KeyRefused: another curve or another algorithm.
    """
    if not isinstance(key, ec.EllipticCurvePublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise KeyRefused("the key is not a P-256 key", "create the key with `rossec node request`")
    return key


def thumbprint(key: ec.EllipticCurvePublicKey) -> bytes:
    """Return the 32-byte COSE key thumbprint of a P-256 key (RFC 9679, SHA-256).

    Raises:
        KeyRefused: not a P-256 key.
    """
    return thumbprint_of(to_coordinates(key))


def thumbprint_of(coordinates: bytes) -> bytes:
    """The thumbprint of the key with these x and y, 64 octets; whether it is one is not checked.

    Raises:
        KeyRefused: of another length.
    """
    if len(coordinates) != 2 * _COORDINATE:
        raise KeyRefused("a key of a wrong length where x and y are expected")
    x, y = coordinates[:_COORDINATE], coordinates[_COORDINATE:]
    return hashlib.sha256(_HEAD + x + _BETWEEN + y).digest()


def to_coordinates(key: ec.EllipticCurvePublicKey) -> bytes:
    """Return x and y of a P-256 key, 64 octets.

    Raises:
        KeyRefused: not a P-256 key.
    """
    return require_p256(key).public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)[1:]


def from_coordinates(data: bytes) -> ec.EllipticCurvePublicKey:
    """Return the P-256 key with the coordinates x and y, 64 octets.

    Raises:
        KeyRefused: not a point of the curve.
    """
    if len(data) != 2 * _COORDINATE:
        raise KeyRefused("a key of a wrong length where x and y are expected")
    try:
        return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x04" + data)
    except ValueError:
        raise KeyRefused("the key is not a point of P-256") from None
