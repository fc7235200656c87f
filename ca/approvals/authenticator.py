"""What an authenticator says in WebAuthn: its data, and its key. Pure.

The beginning of authenticator data has a fixed form (Web Authentication section 6.1), so an
assertion is verified without any library. Only a registration has more that is read
(`ca.approvals.registration`); extensions are signed and ignored, as none is asked for.
"""

from hashlib import sha256
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import decode
from ca.errors import AssertionMalformed, EncodingError, NotVerified, OtherOrigin

MAX_AUTHENTICATOR_DATA: Final = 2048
_FIXED_SIZE: Final = 37  # a digest, the flags, the counter
_PRESENT, _VERIFIED, _MORE = 0x01, 0x04, 0xC0  # UP, UV; AT and ED: more follows
_COORDINATE: Final = 32
_HINT: Final = "try again, or with another browser"


class AuthenticatorData(NamedTuple):
    """The fixed beginning of authenticator data."""

    rp_id_hash: bytes
    flags: int
    counter: int

    @classmethod
    def read(cls, data: bytes) -> "AuthenticatorData":
        """Parse the beginning.

        Raises:
            AssertionMalformed: too short or long, or with bytes that no flag announces.
        """
        if not _FIXED_SIZE <= len(data) <= MAX_AUTHENTICATOR_DATA:
            raise AssertionMalformed(f"{len(data)} bytes of authenticator data", _HINT)
        found = cls(data[:32], data[32], int.from_bytes(data[33:_FIXED_SIZE]))
        if (len(data) > _FIXED_SIZE) != bool(found.flags & _MORE):
            raise AssertionMalformed("authenticator data of another length than it says", _HINT)
        return found

    def check(self, rp_id: str) -> None:
        """Return if the authenticator saw this relying party, and verified its user.

        Raises:
            OtherOrigin: a passkey for another relying party.
            NotVerified: nobody touched it, or no finger, face or PIN.
        """
        if self.rp_id_hash != sha256(rp_id.encode()).digest():
            raise OtherOrigin(
                f"the passkey does not belong to {rp_id}", "register this phone at this console"
            )
        if not (self.flags & _PRESENT and self.flags & _VERIFIED):
            raise NotVerified(
                "the passkey was used without a finger, face or PIN",
                "set up a screen lock on the device, then try again",
            )


def read_key(cose_key: bytes) -> ec.EllipticCurvePublicKey:
    """The P-256 key for ES256 in a COSE_Key (RFC 9053), which has exactly its five parameters.

    Raises:
        AssertionMalformed: any other key or form.
    """
    try:
        match decode(cose_key):
            case {1: 2, 3: -7, -1: 1, -2: bytes(x), -3: bytes(y), **rest} if (
                not rest and len(x) == len(y) == _COORDINATE
            ):
                return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x04" + x + y)
            case _:
                raise AssertionMalformed("the device's key is not an ES256 key", _HINT)
    except (EncodingError, ValueError) as error:
        raise AssertionMalformed("the device's key is not a key of P-256", _HINT) from error
