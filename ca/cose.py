"""COSE_Sign1 (RFC 9052) in one fixed form, shared by every signed statement of rossec.

A statement type is a `Profile`: its protected header is one constant, compared byte for byte, so
algorithm, type and version cannot be negotiated, confused or extended, and `crit` needs no
interpretation. The unprotected header is empty: it is not signed. Trust is not decided here: the
caller supplies the key.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Final

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.utils import encode_dss_signature

from ca.encoding import MAX_SIZE, Value, decode, encode, head
from ca.errors import EncodingError, SignatureError
from ca.keys.signer import Signer

_SIGN1_TAG: Final = b"\xd2"  # tag 18, RFC 9052 section 2
_ALG, _CRIT, _TYP = 1, 2, 16  # RFC 9052 section 3.1; typ: RFC 9596
_ES256: Final = -7
_COORDINATE: Final = 32
_ECDSA: Final = ec.ECDSA(hashes.SHA256())
_BYTES: Final = 0x40  # major type 2
_SIGNATURE_HEAD: Final = b"\x58\x40"  # a byte string of 64 bytes
_HEAD_SIZES: Final = {0x58: 2, 0x59: 3, 0x5A: 5}  # bytes; shorter strings have a head of one byte


@dataclass(frozen=True)
class Profile:
    """One kind of signed statement, named by its media type (for example a grant).

    `typ` is in the signed header and marked critical: a statement of one kind can never be taken
    for another, nor accepted by a generic verifier that does not know it.
    """

    typ: str

    @cached_property
    def protected(self) -> bytes:
        """The one protected header this profile allows, encoded."""
        return encode({_ALG: _ES256, _CRIT: [_TYP], _TYP: self.typ})

    @cached_property
    def _frame(self) -> bytes:
        """The prefix of every statement of this kind, up to its payload."""
        return _SIGN1_TAG + b"\x84" + encode(self.protected) + b"\xa0"

    @cached_property
    def _signed_frame(self) -> bytes:
        """Sig_structure of RFC 9052 section 4.4 with empty external data, up to its payload."""
        return b"\x84" + encode("Signature1") + encode(self.protected) + b"\x40"

    def sign(self, signer: Signer, payload: Value) -> bytes:
        """Sign `payload` (a CBOR value) and return the tagged COSE_Sign1."""
        body = encode(payload)
        signature = signer.sign(self._signed_frame + encode(body))
        return _SIGN1_TAG + encode([self.protected, {}, body, signature])

    def payload_to_sign(self, message: bytes, *, limit: int = MAX_SIZE) -> Value:
        """The payload in `message`, which a signer is asked to sign: see `sign`.

        Raises:
            SignatureError: not what a statement of this kind has signed.
            EncodingError: its payload is not strict deterministic CBOR.
        """
        start = len(self._signed_frame)
        start += _HEAD_SIZES.get(message[start], 1) if start < len(message) else 0
        body = message[start:]
        if message != self._signed_frame + head(_BYTES, len(body)) + body:
            raise SignatureError(f"not a statement of kind {self.typ}")
        return decode(body, limit=limit)

    def open(self, data: bytes, key: ec.EllipticCurvePublicKey, *, limit: int = MAX_SIZE) -> Value:
        """Verify `data` against `key` and return its payload.

        Raises:
            SignatureError: wrong frame, wrong kind of statement, or not signed by `key`.
            EncodingError: not strict deterministic CBOR.
        """
        return decode(self.open_body(data, key, limit=limit), limit=limit)

    def open_body(
        self, data: bytes, key: ec.EllipticCurvePublicKey, *, limit: int = MAX_SIZE
    ) -> bytes:
        """Verify `data` against `key` and return its payload as signed, *not* decoded.

        Raises:
            SignatureError, EncodingError: as `open` does.
        """
        body, signature = self._split(data, limit)
        _verify(key, signature, self._signed_frame + head(_BYTES, len(body)) + body)
        return body

    def check(self, data: bytes, key: ec.EllipticCurvePublicKey, payload: Value) -> None:
        """Return if `data` states exactly `payload`, signed by `key`; nothing of it is decoded.

        Raises:
            SignatureError: it states something else, or `key` did not sign it.
        """
        body = encode(payload)
        text = head(_BYTES, len(body)) + body
        statement = self._frame + text + _SIGNATURE_HEAD
        if not data.startswith(statement) or len(data) != len(statement) + 2 * _COORDINATE:
            raise SignatureError(f"not the expected statement of kind {self.typ}")
        _verify(key, data[len(statement) :], self._signed_frame + text)

    def peek(self, data: bytes, *, limit: int = MAX_SIZE) -> Value:
        """Return the payload *without* verifying: to display, or to find the key to verify with."""
        return decode(self.peek_body(data, limit=limit), limit=limit)

    def peek_body(self, data: bytes, *, limit: int = MAX_SIZE) -> bytes:
        """Return the payload as `open_body` does, *without* verifying."""
        return self._split(data, limit)[0]

    def _split(self, data: bytes, limit: int) -> tuple[bytes, bytes]:
        """Return payload and signature: compare with the only allowed form instead of decoding."""
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
        return self._split_by_decoding(data, limit)

    def _split_by_decoding(self, data: bytes, limit: int) -> tuple[bytes, bytes]:
        """As `_split`, for any other form: decode it to report the error."""
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


def _verify(key: ec.EllipticCurvePublicKey, signature: bytes, message: bytes) -> None:
    if len(signature) != 2 * _COORDINATE:
        raise SignatureError("signature of a wrong length")
    r = int.from_bytes(signature[:_COORDINATE])
    s = int.from_bytes(signature[_COORDINATE:])
    try:
        key.verify(encode_dss_signature(r, s), message, _ECDSA)
    except InvalidSignature:
        raise SignatureError("the signature does not verify") from None
