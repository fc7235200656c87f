"""COSE_Sign1 (RFC 9052) in one closed form, shared by every signed statement of rossec.

A statement type is a `Profile`: its protected header is one constant, compared byte for byte, so
algorithm, type and version cannot be negotiated, confused or extended, and `crit` needs no
interpretation. The unprotected header is empty: it is outside the signature. Nothing here
decides *whom* to trust; the caller brings the key.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from ca.encoding import MAX_SIZE, Value, decode, encode
from ca.errors import SignatureError
from ca.signer import Signer

_SIGN1_TAG: Final = b"\xd2"  # tag 18, RFC 9052 section 2
_ALG, _CRIT, _TYP = 1, 2, 16  # RFC 9052 section 3.1; typ: RFC 9596
_ES256: Final = -7
_COORDINATE: Final = 32


@dataclass(frozen=True)
class Profile:
    """One kind of signed statement, named by its media type (for example a grant).

    `typ` sits in the signed header and is marked critical: a statement of one kind can never be
    taken for another, nor accepted by a generic verifier that does not know it.
    """

    typ: str

    @cached_property
    def protected(self) -> bytes:
        """The one protected header this profile allows, encoded."""
        return encode({_ALG: _ES256, _CRIT: [_TYP], _TYP: self.typ})

    def sign(self, signer: Signer, payload: Value) -> bytes:
        """Sign `payload` (a CBOR value) and return the tagged COSE_Sign1."""
        body = encode(payload)
        signature = signer.sign(_to_be_signed(self.protected, body))
        return _SIGN1_TAG + encode([self.protected, {}, body, signature])

    def open(self, data: bytes, key: ec.EllipticCurvePublicKey, *, limit: int = MAX_SIZE) -> Value:
        """Verify `data` against `key` and return its payload.

        Raises:
            SignatureError: wrong frame, wrong kind of statement, or not signed by `key`.
            EncodingError: not strict deterministic CBOR.
        """
        body, signature = self._split(data, limit)
        _verify(key, signature, _to_be_signed(self.protected, body))
        return decode(body, limit=limit)

    def peek(self, data: bytes, *, limit: int = MAX_SIZE) -> Value:
        """Return the payload *without* verifying: to display, or to find the key to verify with."""
        body, _ = self._split(data, limit)
        return decode(body, limit=limit)

    def _split(self, data: bytes, limit: int) -> tuple[bytes, bytes]:
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


def _to_be_signed(protected: bytes, body: bytes) -> bytes:
    """Sig_structure of RFC 9052 section 4.4, with empty external data."""
    return encode(["Signature1", protected, b"", body])


def _verify(key: ec.EllipticCurvePublicKey, signature: bytes, message: bytes) -> None:
    if len(signature) != 2 * _COORDINATE:
        raise SignatureError("signature of a wrong length")
    r = int.from_bytes(signature[:_COORDINATE])
    s = int.from_bytes(signature[_COORDINATE:])
    try:
        key.verify(encode_dss_signature(r, s), message, ec.ECDSA(hashes.SHA256()))
    except InvalidSignature:
        raise SignatureError("the signature does not verify") from None
