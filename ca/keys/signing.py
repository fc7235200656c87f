"""P-256 keys, their thumbprints, and the one form of signed statement (COSE_Sign1, RFC 9052).

Keys are identified by their COSE thumbprint (RFC 9679): grants, lists and logs refer to the key, not
to one of its certificates. A renewed certificate keeps its grants, a revoked key loses all. A
`Signer` signs and does not expose the key, be it in a file or in a token. A statement type is a
`Profile`: its protected header is one constant, compared byte for byte, so algorithm, type and
version cannot be negotiated, confused or extended.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Final, NoReturn, Protocol, TypeAlias

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import decode_dss_signature, encode_dss_signature

from ca.encoding import MAX_SIZE, Value, decode, encode, head
from ca.errors import EncodingError, KeyRefused, SignatureError

THUMBPRINT_SIZE: Final = 32
_COORDINATE: Final = 32

# The deterministic COSE_Key {1: 2 (EC2), -1: 1 (P-256), -2: x, -3: y} has a fixed shape.
_HEAD: Final = bytes.fromhex("a40102200121 5820")
_BETWEEN: Final = bytes.fromhex("225820")

_ECDSA: Final = ec.ECDSA(hashes.SHA256())

Buffer: TypeAlias = bytes | bytearray | memoryview
PublicKey: TypeAlias = ec.EllipticCurvePublicKey

_SIGN1_TAG: Final = b"\xd2"  # tag 18, RFC 9052 section 2
_ALG, _CRIT, _TYP = 1, 2, 16  # RFC 9052 section 3.1; typ: RFC 9596
_COSE_ES256: Final = -7
_BYTES: Final = 0x40  # major type 2
_SIGNATURE_HEAD: Final = b"\x58\x40"  # a byte string of 64 bytes
_HEAD_SIZES: Final = {0x58: 2, 0x59: 3, 0x5A: 5}  # bytes; shorter strings have a head of one byte


def require_p256(key: object) -> PublicKey:
    if not isinstance(key, PublicKey) or not isinstance(key.curve, ec.SECP256R1):
        raise KeyRefused("the key is not a P-256 key", "create the key with `rossec node request`")
    return key


def thumbprint(key: PublicKey) -> bytes:
    """Return the 32-byte COSE key thumbprint of a P-256 key (RFC 9679, SHA-256)."""
    return thumbprint_of(to_coordinates(key))


def thumbprint_of(coordinates: bytes) -> bytes:
    """The thumbprint of the key with these x and y, 64 octets; whether it is one is not checked."""
    if len(coordinates) != 2 * _COORDINATE:
        raise KeyRefused("a key of a wrong length where x and y are expected")
    x, y = coordinates[:_COORDINATE], coordinates[_COORDINATE:]
    return hashlib.sha256(_HEAD + x + _BETWEEN + y).digest()


def to_coordinates(key: PublicKey) -> bytes:
    return require_p256(key).public_bytes(
        serialization.Encoding.X962, serialization.PublicFormat.UncompressedPoint
    )[1:]


def from_coordinates(data: bytes) -> PublicKey:
    if len(data) != 2 * _COORDINATE:
        raise KeyRefused("a key of a wrong length where x and y are expected")
    try:
        return PublicKey.from_encoded_point(ec.SECP256R1(), b"\x04" + data)
    except ValueError:
        raise KeyRefused("the key is not a point of P-256") from None


class Signer(Protocol):
    """A P-256 private key, in memory or in a token."""

    @property
    def public_key(self) -> PublicKey: ...

    def sign(self, message: bytes) -> bytes:
        """ES256 over `message`: 64 bytes, r || s (RFC 9053 section 2.1)."""
        ...


class KeySigner:
    __slots__ = ("_key",)

    def __init__(self, key: ec.EllipticCurvePrivateKey) -> None:
        self._key = key

    @property
    def public_key(self) -> PublicKey:
        return self._key.public_key()

    def sign(self, message: bytes) -> bytes:
        r, s = decode_dss_signature(self._key.sign(message, _ECDSA))
        return r.to_bytes(_COORDINATE) + s.to_bytes(_COORDINATE)


class X509Signer(ec.EllipticCurvePrivateKey):
    """A P-256 private key for the builders of `cryptography.x509`, over a `Signer`.

    They require one of the library's classes; a subclass that forwards `sign` is enough.
    """

    def __init__(self, signer: Signer) -> None:
        self._signer = signer

    def sign(self, data: Buffer, signature_algorithm: ec.EllipticCurveSignatureAlgorithm) -> bytes:
        """ECDSA with SHA-256 over `data`, in DER; any other algorithm is a `TypeError`."""
        algorithm = signature_algorithm.algorithm
        if not isinstance(algorithm, hashes.SHA256):
            raise TypeError("a Signer signs with SHA-256 only")
        raw = self._signer.sign(bytes(data))
        return encode_dss_signature(int.from_bytes(raw[:32]), int.from_bytes(raw[32:]))

    def public_key(self) -> PublicKey:
        return self._signer.public_key

    @property
    def curve(self) -> ec.EllipticCurve:
        return ec.SECP256R1()

    @property
    def key_size(self) -> int:
        return 256

    def exchange(self, algorithm: ec.ECDH, peer_public_key: PublicKey) -> NoReturn:
        raise NotImplementedError("a Signer only signs")

    def private_numbers(self) -> NoReturn:
        raise NotImplementedError("a Signer does not expose its key")

    def private_bytes(
        self,
        encoding: serialization.Encoding,
        format: serialization.PrivateFormat,  # noqa: A002  (the name the library gave it)
        encryption_algorithm: serialization.KeySerializationEncryption,
    ) -> NoReturn:
        raise NotImplementedError("a Signer does not expose its key")

    def __copy__(self) -> "X509Signer":
        return self

    def __deepcopy__(self, memo: dict[int, object]) -> "X509Signer":
        return self


@dataclass(frozen=True)
class Profile:
    """One kind of signed statement, named by its media type (for example a grant).

    `typ` is in the signed header and marked critical: a statement of one kind can never be taken
    for another, nor accepted by a generic verifier that does not know it.
    """

    typ: str

    @cached_property
    def protected(self) -> bytes:
        return encode({_ALG: _COSE_ES256, _CRIT: [_TYP], _TYP: self.typ})

    @cached_property
    def _frame(self) -> bytes:
        return _SIGN1_TAG + b"\x84" + encode(self.protected) + b"\xa0"

    @cached_property
    def _signed_frame(self) -> bytes:
        # Sig_structure of RFC 9052 section 4.4 with empty external data, up to its payload.
        return b"\x84" + encode("Signature1") + encode(self.protected) + b"\x40"

    def sign(self, signer: Signer, payload: Value) -> bytes:
        """Sign `payload` (a CBOR value) and return the tagged COSE_Sign1."""
        body = encode(payload)
        signature = signer.sign(self._signed_frame + encode(body))
        return _SIGN1_TAG + encode([self.protected, {}, body, signature])

    def payload_to_sign(self, message: bytes, *, limit: int = MAX_SIZE) -> Value:
        """The payload in `message`, which a signer is asked to sign: see `sign`."""
        start = len(self._signed_frame)
        start += _HEAD_SIZES.get(message[start], 1) if start < len(message) else 0
        body = message[start:]
        if message != self._signed_frame + head(_BYTES, len(body)) + body:
            raise SignatureError(f"not a statement of kind {self.typ}")
        return decode(body, limit=limit)

    def open(self, data: bytes, key: PublicKey, *, limit: int = MAX_SIZE) -> Value:
        """Verify `data` against `key` and return its payload."""
        return decode(self.open_body(data, key, limit=limit), limit=limit)

    def open_body(self, data: bytes, key: PublicKey, *, limit: int = MAX_SIZE) -> bytes:
        """Verify `data` against `key` and return its payload as signed, *not* decoded."""
        body, signature = self._split(data, limit)
        _verify(key, signature, self._signed_frame + head(_BYTES, len(body)) + body)
        return body

    def check(self, data: bytes, key: PublicKey, payload: Value) -> None:
        """Return if `data` states exactly `payload`, signed by `key`; nothing of it is decoded."""
        # The expected statement is made and compared: the payload of a stranger is never parsed.
        body = encode(payload)
        text = head(_BYTES, len(body)) + body
        statement = self._frame + text + _SIGNATURE_HEAD
        if not data.startswith(statement) or len(data) != len(statement) + 2 * _COORDINATE:
            raise SignatureError(f"not the expected statement of kind {self.typ}")
        _verify(key, data[len(statement) :], self._signed_frame + text)

    def peek(self, data: bytes, *, limit: int = MAX_SIZE) -> Value:
        return decode(self.peek_body(data, limit=limit), limit=limit)

    def peek_body(self, data: bytes, *, limit: int = MAX_SIZE) -> bytes:
        return self._split(data, limit)[0]

    def _split(self, data: bytes, limit: int) -> tuple[bytes, bytes]:
        # Return payload and signature: compare with the only allowed form instead of decoding.
        if len(data) > limit:
            raise EncodingError(f"{len(data)} bytes of CBOR where at most {limit} are allowed")
        start, end = len(self._frame), len(data) - len(_SIGNATURE_HEAD) - 2 * _COORDINATE
        start += _HEAD_SIZES.get(data[start], 1) if start < end else 0
        body = data[start:end]
        if (
            start <= end
            and data[:start] == self._frame + head(_BYTES, len(body))
            and data.startswith(_SIGNATURE_HEAD, end)
        ):
            return body, data[-2 * _COORDINATE :]
        # Not that form: decoded, only to say what is wrong with it.
        if data[:1] != _SIGN1_TAG:
            raise SignatureError("not a COSE_Sign1 statement")
        match decode(data[1:], limit=limit):
            case [bytes() as protected, {**unprotected}, bytes() as body, bytes() as signature]:
                if unprotected:
                    raise SignatureError("COSE_Sign1 with an unprotected header")
                if protected != self.protected:
                    raise SignatureError(f"not a statement of kind {self.typ}")
                return body, signature
            case _:
                raise SignatureError("not a COSE_Sign1 statement")


def _verify(key: PublicKey, signature: bytes, message: bytes) -> None:
    if len(signature) != 2 * _COORDINATE:
        raise SignatureError("signature of a wrong length")
    r = int.from_bytes(signature[:_COORDINATE])
    s = int.from_bytes(signature[_COORDINATE:])
    try:
        key.verify(encode_dss_signature(r, s), message, _ECDSA)
    except InvalidSignature:
        raise SignatureError("the signature does not verify") from None
