"""Constrained things: how one proves who it is, and what the authority says of it.

A thing keeps its credential in flash, for years and under names it does not know: a CCS (RFC 8392
claims with a COSE_Key, RFC 9528 section 3.5.2). A border router serves a thing only by the
authority's statement. Of two statements about a name the one with the later `nbf` counts; the
authority revokes those that it replaces. docs/spec/things.md
"""

import hashlib
import re
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.encoding import Value, decode, encode, is_number
from ca.errors import CAError, EncodingError, SignatureError, ThingOutdated, ThingRefused
from ca.keys.signing import THUMBPRINT_SIZE, Profile, Signer, from_coordinates, thumbprint_of, to_coordinates
from ca.names import check_domain, check_name, is_alias, is_reserved

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

# The text that carries a secret to its thing stays in the alphanumeric mode of QR codes, and a
# microcontroller reads it in ten lines of C. It is never printed on a label: who sees it can speak as the
# thing, and to the thing as its border router.
_TEXT: Final = re.compile(
    rf"OSCORE:((?:[0-9A-F]{{2}}){{1,{MAX_SECRET_KID}}}):([0-9A-F]{{{2 * SECRET_SIZE}}})"
)

THING: Final = Profile("rossec-thing+cwt")
MAX_STATEMENT: Final = 1024
SERIAL_SIZE: Final = 16
ID_SIZE: Final = 16
EDHOC, PSK = "edhoc", "psk"

_AUD, _EXP, _NBF, _CTI, _BORDER, _SUBJECT = 3, 4, 5, 7, -70035, -70040
_ID_PREFIX: Final = b"rossec-thing-id\0" + len(THING.protected).to_bytes(4) + THING.protected
_STATEMENT_HINT: Final = "give a file that `rossec ca thing` wrote"


@dataclass(frozen=True)
class ThingKey:
    """The public key of a thing that speaks EDHOC, as its credential has it."""

    kid: bytes  # 1 to 8 octets; how a handshake names the key
    coordinates: bytes  # x and y, 64 octets
    subject: str = ""  # the name that the thing gives itself, if any; it means nothing here

    def __post_init__(self) -> None:
        if not 1 <= len(self.kid) <= MAX_KEY_KID:
            raise ThingRefused(f"a kid of {len(self.kid)} octets, 1 to {MAX_KEY_KID}", _HINT)
        if len(self.subject.encode()) > MAX_SUBJECT:
            raise ThingRefused(f"a subject of more than {MAX_SUBJECT} octets", _HINT)
        from_coordinates(self.coordinates)

    @classmethod
    def of(cls, key: ec.EllipticCurvePublicKey, kid: bytes, subject: str = "") -> "ThingKey":
        return cls(kid, to_coordinates(key), subject)

    @cached_property
    def public_key(self) -> ec.EllipticCurvePublicKey:
        return from_coordinates(self.coordinates)

    @cached_property
    def thumbprint(self) -> bytes:
        return thumbprint_of(self.coordinates)

    @property
    def confirmation(self) -> dict[int | str, Value]:
        """The claim `cnf` with it: the same map in the CCS and in the authority's statement."""
        x, y = self.coordinates[:_COORDINATE], self.coordinates[_COORDINATE:]
        key: dict[int | str, Value] = {_KTY: _EC2, _KID: self.kid, _CRV: _P256, _X: x, _Y: y}
        return {_COSE_KEY: key}

    @property
    def ccs(self) -> bytes:
        subject: dict[int | str, Value] = {_SUB: self.subject} if self.subject else {}
        return encode({**subject, _CNF: self.confirmation})


@dataclass(frozen=True)
class ThingSecret:
    """Which OSCORE secret a thing without curves has; not the secret."""

    kid: bytes  # 1 to 7 octets; the thing's OSCORE sender ID. That of the border router is empty
    thumbprint: bytes  # of the master secret (RFC 9679): of 16 random octets it tells nothing

    def __post_init__(self) -> None:
        if not 1 <= len(self.kid) <= MAX_SECRET_KID:
            raise ThingRefused(f"a sender ID of {len(self.kid)} octets, 1 to {MAX_SECRET_KID}")
        if len(self.thumbprint) != hashlib.sha256().digest_size:
            raise ThingRefused("the thumbprint of a secret has 32 octets")

    @classmethod
    def of(cls, secret: bytes, kid: bytes) -> "ThingSecret":
        return cls(kid, secret_thumbprint(secret))

    @property
    def description(self) -> bytes:
        """The claims that stand for a CCS: what the authority is given. It is no secret."""
        return encode({_CNF: write_confirmation(self)})

    def matches(self, secret: bytes) -> bool:
        return len(secret) == SECRET_SIZE and secret_thumbprint(secret) == self.thumbprint


Credential = ThingKey | ThingSecret
"""How a thing proves who it is."""


def secret_thumbprint(secret: bytes) -> bytes:
    """The COSE thumbprint of a master secret: of the symmetric key {1: 4, -1: k} (RFC 9679)."""
    if len(secret) != SECRET_SIZE:
        raise ThingRefused(f"a secret of {len(secret)} octets, not of {SECRET_SIZE}")
    return hashlib.sha256(encode({_KTY: _SYMMETRIC, _K: secret})).digest()


def read_ccs(data: bytes) -> ThingKey:
    """The key in a CCS of at most 192 octets, which holds nothing else (RFC 9528 section 3.5.2)."""
    if len(data) > MAX_CCS:
        raise ThingRefused(f"a credential of {len(data)} octets, at most {MAX_CCS}", _HINT)
    try:
        value = decode(data, limit=MAX_CCS)
    except EncodingError as error:
        raise ThingRefused(f"not a credential of a thing: {error}", _HINT) from None
    # Taken as the thing has it, for its bytes enter the handshake; but only in the one deterministic form.
    match value:
        case {8: confirmation, **rest} if rest.keys() <= {_SUB}:
            subject = rest.get(_SUB, "")
        case _:
            raise ThingRefused("a credential with missing or unknown claims", _HINT)
    if not isinstance(subject, str) or (_SUB in rest and not subject):
        raise ThingRefused("a credential whose subject is empty, or not text", _HINT)
    return read_key(confirmation, subject)


def read_description(data: bytes) -> ThingSecret:
    """What `ThingSecret.description` wrote, or `ThingRefused`."""
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
    match confirmation:
        case {1: {1: 2, 2: bytes() as kid, -1: 1, -2: bytes() as x, -3: bytes() as y, **more}, **rest} if (
            not rest and not more and len(x) == len(y) == _COORDINATE
        ):
            key = ThingKey(kid, x + y, subject)
        case _:
            raise ThingRefused("not a P-256 key with kid, x and y of 32 octets each", _HINT)
    if encode(key.confirmation) != encode(confirmation):  # True == 1 in Python
        raise ThingRefused("not a P-256 key with kid, x and y of 32 octets each", _HINT)
    return key


def read_confirmation(confirmation: Value, subject: str) -> Credential:
    match confirmation:
        case {3: bytes() as kid, 5: bytes() as thumbprint, **rest} if not rest:
            if subject:
                raise ThingRefused("a secret has no subject")
            return ThingSecret(kid, thumbprint)
        case _:
            return read_key(confirmation, subject)


def write_confirmation(credential: Credential) -> dict[int | str, Value]:
    if isinstance(credential, ThingKey):
        return credential.confirmation
    return {3: credential.kid, 5: credential.thumbprint}


def secret_text(kid: bytes, secret: bytes) -> str:
    """`OSCORE:KID:SECRET` in hexadecimal digits, for the QR code from which a thing reads its secret."""
    text = f"OSCORE:{kid.hex()}:{secret.hex()}".upper()
    parse_secret(text)
    return text


def parse_secret(text: str) -> tuple[bytes, bytes]:
    found = _TEXT.fullmatch(text.strip())
    if found is None:
        raise ThingRefused("not the secret of a thing", "OSCORE:KID:SECRET, in hexadecimal digits")
    return bytes.fromhex(found[1]), bytes.fromhex(found[2])


@dataclass(frozen=True)
class ThingStatement:
    """One thing, as the authority states it, for not_before <= now < expires."""

    domain: str
    name: str  # its own ROS name, for example /things/lamp; the border router holds that identity
    credential: Credential
    border: bytes  # thumbprint of the key of the border router that serves it
    not_before: int
    expires: int
    serial: bytes  # 16 random octets

    def __post_init__(self) -> None:
        check_domain(self.domain)
        check_thing_name(self.name)
        if not (is_number(self.not_before) and is_number(self.expires)):
            raise ThingRefused("a time of a thing's statement is out of range")
        if self.expires <= self.not_before:
            raise ThingRefused("a thing's statement that is never valid")
        if len(self.border) != THUMBPRINT_SIZE or len(self.serial) != SERIAL_SIZE:
            raise ThingRefused("a thing's statement whose thumbprint or serial has a wrong length")

    @property
    def kind(self) -> str:
        return EDHOC if isinstance(self.credential, ThingKey) else PSK

    @property
    def id(self) -> bytes:
        # Without the signature, as a grant's id: ECDSA has many for one content, and each would be another
        # entry of the revocation list.
        return hashlib.sha256(_ID_PREFIX + encode(_claims(self))).digest()[:ID_SIZE]

    def check_time(self, now: int) -> None:
        if now >= self.expires:
            late = now - self.expires
            renew = f"renew it where the authority is: rossec ca thing {self.name} --renew"
            raise ThingOutdated(f"the statement about {self.name} expired {late} s ago", renew)
        if now < self.not_before:
            raise ThingOutdated(
                f"the statement about {self.name} is not valid for another {self.not_before - now} s",
                "check the clocks of both computers",
            )


def check_thing_name(name: str) -> str:
    """Return `name` if a thing may have it."""
    check_name(name)
    # Nodes trust the holders of reserved names, and a border router holds those of its things.
    if is_reserved(name) or is_alias(name):
        raise ThingRefused(f"{name} cannot be the name of a thing", "choose another, as /things/lamp")
    return name


def sign_statement(signer: Signer, statement: ThingStatement) -> bytes:
    """The COSE_Sign1 that the border router is given (docs/spec/things.md)."""
    return THING.sign(signer, _claims(statement))


def open_statement(
    data: bytes, ca_key: ec.EllipticCurvePublicKey, now: int, *, domain: str
) -> ThingStatement:
    """Verify a statement and read it: of the authority with `ca_key`, for `domain`, valid at `now`."""
    # Whether it is revoked, and for whose border router it is, is for the caller to check.
    statement = verify_statement(data, ca_key, domain=domain)
    statement.check_time(now)
    return statement


def verify_statement(data: bytes, ca_key: ec.EllipticCurvePublicKey, *, domain: str) -> ThingStatement:
    """As `open_statement`, without checking the time."""
    try:
        body = THING.open_body(data, ca_key, limit=MAX_STATEMENT)
    except (SignatureError, EncodingError) as error:
        raise ThingRefused(f"not a statement of this authority: {error}", _STATEMENT_HINT) from None
    statement = _read(body)
    if statement.domain != domain:
        raise ThingRefused(
            f"a thing of the trust domain {statement.domain!r}, not of {domain!r}", _STATEMENT_HINT
        )
    return statement


def peek_statement(data: bytes) -> ThingStatement:
    """Read a statement *without* verifying it: to show it."""
    try:
        body = THING.peek_body(data, limit=MAX_STATEMENT)
    except (SignatureError, EncodingError) as error:
        raise ThingRefused(f"not a statement about a thing: {error}", _STATEMENT_HINT) from None
    return _read(body)


def _claims(statement: ThingStatement) -> dict[int | str, Value]:
    claims: dict[int | str, Value] = {
        _SUB: statement.name,
        _AUD: statement.domain,
        _EXP: statement.expires,
        _NBF: statement.not_before,
        _CTI: statement.serial,
        _CNF: write_confirmation(statement.credential),
        _BORDER: statement.border,
    }
    if isinstance(statement.credential, ThingKey) and statement.credential.subject:
        claims[_SUBJECT] = statement.credential.subject
    return claims


def _read(body: bytes) -> ThingStatement:
    try:
        payload = decode(body, limit=MAX_STATEMENT)
        match payload:
            case {
                2: str() as name,
                3: str() as domain,
                4: int() as exp,
                5: int() as nbf,
                7: bytes() as serial,
                8: confirmation,
                -70035: bytes() as border,
                **rest,
            } if rest.keys() <= {_SUBJECT}:
                subject = rest.get(_SUBJECT, "")
            case _:
                raise ThingRefused("a thing's statement has missing or unknown claims", _STATEMENT_HINT)
        if not isinstance(subject, str) or (_SUBJECT in rest and not subject):
            raise ThingRefused("the subject of a thing's credential is empty, or not text", _STATEMENT_HINT)
        credential = read_confirmation(confirmation, subject)
        return ThingStatement(domain, name, credential, border, nbf, exp, serial)
    except ThingRefused:
        raise
    except CAError as error:
        raise ThingRefused(f"in the statement about a thing: {error}", error.hint) from error
