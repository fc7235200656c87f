"""How a thing proves who it is: a key for EDHOC, or an OSCORE secret that only its border has.

A thing keeps its credential in flash, for years and under names it does not know. So a CCS (RFC
8392 claims with a COSE_Key, RFC 9528 section 3.5.2) is taken as the thing has it, for its bytes
enter the handshake; but only in the one deterministic form, so that its parts say it all. A secret
is named by its thumbprint (RFC 9679), which of 16 random octets tells nothing about them.
"""

import hashlib
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, decode, encode
from ca.errors import EncodingError, ThingRefused
from ca.keys.publickey import from_coordinates, thumbprint_of, to_coordinates

MAX_CCS: Final = 192  # octets; what lakers keeps of a credential
MAX_KEY_KID: Final = 8
MAX_SECRET_KID: Final = 7  # the sender ID of a thing: a nonce of AES-CCM-16-64-128 has no more room
MAX_SUBJECT: Final = 64  # octets
SECRET_SIZE: Final = 16
_COORDINATE: Final = 32
_KTY, _KID, _CRV, _X, _Y, _K = 1, 2, -1, -2, -3, -1  # RFC 9053 section 7
_EC2, _SYMMETRIC, _P256 = 2, 4, 1
_SUB, _CNF, _COSE_KEY = 2, 8, 1  # RFC 8392 section 4, RFC 8747 section 3.1
_HINT: Final = "the thing's credential is a CCS: its subject and its P-256 key with a kid, as CBOR"


@dataclass(frozen=True)
class ThingKey:
    """The public key of a thing that speaks EDHOC, as its credential has it.

    Args:
        kid: 1 to 8 octets; how a handshake names the key.
        coordinates: x and y, 64 octets.
        subject: the name that the thing gives itself, if any; it means nothing here.
    """

    kid: bytes
    coordinates: bytes
    subject: str = ""

    def __post_init__(self) -> None:
        if not 1 <= len(self.kid) <= MAX_KEY_KID:
            raise ThingRefused(f"a kid of {len(self.kid)} octets, 1 to {MAX_KEY_KID}", _HINT)
        if len(self.subject.encode()) > MAX_SUBJECT:
            raise ThingRefused(f"a subject of more than {MAX_SUBJECT} octets", _HINT)
        from_coordinates(self.coordinates)

    @classmethod
    def of(cls, key: ec.EllipticCurvePublicKey, kid: bytes, subject: str = "") -> "ThingKey":
        """The credential of a P-256 key.

        Raises:
            KeyRefused: another curve.
            ThingRefused: kid or subject is not in form.
        """
        return cls(kid, to_coordinates(key), subject)

    @cached_property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        """The key."""
        return from_coordinates(self.coordinates)

    @cached_property
    def thumbprint(self) -> bytes:
        """Its COSE thumbprint, as that of any other key."""
        return thumbprint_of(self.coordinates)

    @property
    def confirmation(self) -> dict[int | str, Value]:
        """The claim `cnf` with it: the same map in the CCS and in the authority's statement."""
        x, y = self.coordinates[:_COORDINATE], self.coordinates[_COORDINATE:]
        key: dict[int | str, Value] = {_KTY: _EC2, _KID: self.kid, _CRV: _P256, _X: x, _Y: y}
        return {_COSE_KEY: key}

    @property
    def ccs(self) -> bytes:
        """The credential as the thing has it: CRED_R or CRED_I of its handshakes."""
        subject: dict[int | str, Value] = {_SUB: self.subject} if self.subject else {}
        return encode({**subject, _CNF: self.confirmation})


@dataclass(frozen=True)
class ThingSecret:
    """Which OSCORE secret a thing without curves has; not the secret.

    Args:
        kid: 1 to 7 octets; the thing's OSCORE sender ID. That of the border router is empty.
        thumbprint: of the master secret, 32 octets.
    """

    kid: bytes
    thumbprint: bytes

    def __post_init__(self) -> None:
        if not 1 <= len(self.kid) <= MAX_SECRET_KID:
            raise ThingRefused(f"a sender ID of {len(self.kid)} octets, 1 to {MAX_SECRET_KID}")
        if len(self.thumbprint) != hashlib.sha256().digest_size:
            raise ThingRefused("the thumbprint of a secret has 32 octets")

    @classmethod
    def of(cls, secret: bytes, kid: bytes) -> "ThingSecret":
        """What is said about `secret`.

        Raises:
            ThingRefused: it has not 16 octets, or kid is not in form.
        """
        return cls(kid, secret_thumbprint(secret))

    @property
    def description(self) -> bytes:
        """The claims that stand for a CCS: what the authority is given. It is no secret."""
        return encode({_CNF: write_confirmation(self)})

    def matches(self, secret: bytes) -> bool:
        """Whether this is about `secret`."""
        return len(secret) == SECRET_SIZE and secret_thumbprint(secret) == self.thumbprint


Credential = ThingKey | ThingSecret
"""How a thing proves who it is."""


def secret_thumbprint(secret: bytes) -> bytes:
    """The COSE thumbprint of a master secret: of the symmetric key {1: 4, -1: k} (RFC 9679).

    Raises:
        ThingRefused: it has not 16 octets.
    """
    if len(secret) != SECRET_SIZE:
        raise ThingRefused(f"a secret of {len(secret)} octets, not of {SECRET_SIZE}")
    return hashlib.sha256(encode({_KTY: _SYMMETRIC, _K: secret})).digest()


def read_ccs(data: bytes) -> ThingKey:
    """Read the credential of a thing, as bytes of its CCS.

    Raises:
        ThingRefused: not of the one form, or too large for small libraries.
        KeyRefused: its key is not a point of P-256.
    """
    if len(data) > MAX_CCS:
        raise ThingRefused(f"a credential of {len(data)} octets, at most {MAX_CCS}", _HINT)
    try:
        value = decode(data, limit=MAX_CCS)
    except EncodingError as error:
        raise ThingRefused(f"not a credential of a thing: {error}", _HINT) from None
    match value:
        case {8: confirmation, **rest} if rest.keys() <= {_SUB}:
            subject = rest.get(_SUB, "")
        case _:
            raise ThingRefused("a credential with missing or unknown claims", _HINT)
    if not isinstance(subject, str) or (_SUB in rest and not subject):
        raise ThingRefused("a credential whose subject is empty, or not text", _HINT)
    return read_key(confirmation, subject)


def read_description(data: bytes) -> ThingSecret:
    """Read what `ThingSecret.description` wrote.

    Raises:
        ThingRefused: anything else.
    """
    hint = "give the file that `rossec border add NAME --psk` wrote, not the secret"
    try:
        match decode(data, limit=MAX_CCS):
            case {8: {3: _, 5: _, **more} as confirmation, **rest} if not rest and not more:
                found = read_confirmation(confirmation, "")
            case _:
                raise ThingRefused("not a description of a secret", hint)
    except EncodingError as error:
        raise ThingRefused(f"not a description of a secret: {error}", hint) from None
    if not isinstance(found, ThingSecret):
        raise ThingRefused("not a description of a secret", hint)
    return found


def read_key(confirmation: Value, subject: str) -> ThingKey:
    """The key in a claim `cnf`.

    Raises:
        ThingRefused: not {1: COSE_Key}, or a COSE_Key of another form.
        KeyRefused: its key is not a point of P-256.
    """
    match confirmation:
        case {
            1: {1: 2, 2: bytes() as kid, -1: 1, -2: bytes() as x, -3: bytes() as y, **more},
            **rest,
        } if not rest and not more and len(x) == len(y) == _COORDINATE:
            key = ThingKey(kid, x + y, subject)
        case _:
            raise ThingRefused("not a P-256 key with kid, x and y of 32 octets each", _HINT)
    if encode(key.confirmation) != encode(confirmation):  # True == 1 in Python
        raise ThingRefused("not a P-256 key with kid, x and y of 32 octets each", _HINT)
    return key


def read_confirmation(confirmation: Value, subject: str) -> Credential:
    """The credential in the claim `cnf` of a statement: of either class.

    Raises:
        CAError: neither of them, or a secret that has a subject.
    """
    match confirmation:
        case {3: bytes() as kid, 5: bytes() as thumbprint, **rest} if not rest:
            if subject:
                raise ThingRefused("a secret has no subject")
            return ThingSecret(kid, thumbprint)
        case _:
            return read_key(confirmation, subject)


def write_confirmation(credential: Credential) -> dict[int | str, Value]:
    """The claim `cnf` for a credential."""
    if isinstance(credential, ThingKey):
        return credential.confirmation
    return {3: credential.kid, 5: credential.thumbprint}
