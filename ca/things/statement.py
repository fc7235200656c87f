"""What the authority says of a thing: its name, its credential, and which border router has it.

A border router serves a thing only by such a statement, which names the router's own key: one for
another router is of no use to it. It is not secret. Its id lies on the revocation list as a
grant's does, and has no signature in it for the same reason (`grants.document`). Of two statements
about a name the one with the later `nbf` counts; the authority revokes those that it replaces.
docs/spec/things.md
"""

import hashlib
from dataclasses import dataclass
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.domains.aliases import is_alias
from ca.encoding import Value, decode, encode
from ca.errors import CAError, EncodingError, SignatureError, ThingOutdated, ThingRefused
from ca.keys.publickey import THUMBPRINT_SIZE
from ca.keys.signer import Signer
from ca.names import check_domain, check_name, is_reserved
from ca.things.credentials import Credential, ThingKey, read_confirmation, write_confirmation

THING: Final = Profile("rossec-thing+cwt")
MAX_STATEMENT: Final = 1024
SERIAL_SIZE: Final = 16
ID_SIZE: Final = 16
EDHOC, PSK = "edhoc", "psk"

_SUB, _AUD, _EXP, _NBF, _CTI, _CNF, _BORDER, _SUBJECT = 2, 3, 4, 5, 7, 8, -70035, -70040
_INT_LIMIT: Final = 1 << 53
_ID_PREFIX: Final = b"rossec-thing-id\0" + len(THING.protected).to_bytes(4) + THING.protected
_HINT: Final = "give a file that `rossec ca thing` wrote"


@dataclass(frozen=True)
class ThingStatement:
    """One thing, as the authority states it.

    Args:
        domain: the trust domain it is in.
        name: its own ROS name, for example /things/lamp; the border router holds that identity.
        credential: its key, or which secret it has.
        border: thumbprint of the key of the border router that serves it.
        not_before, expires: seconds, not_before <= now < expires.
        serial: 16 random octets.
    """

    domain: str
    name: str
    credential: Credential
    border: bytes
    not_before: int
    expires: int
    serial: bytes

    def __post_init__(self) -> None:
        check_domain(self.domain)
        check_thing_name(self.name)
        times = (self.not_before, self.expires)
        if not all(type(time) is int and 0 <= time < _INT_LIMIT for time in times):
            raise ThingRefused("a time of a thing's statement is out of range")
        if self.expires <= self.not_before:
            raise ThingRefused("a thing's statement that is never valid")
        if len(self.border) != THUMBPRINT_SIZE or len(self.serial) != SERIAL_SIZE:
            raise ThingRefused("a thing's statement whose thumbprint or serial has a wrong length")

    @property
    def kind(self) -> str:
        """Its class: `EDHOC` or `PSK`."""
        return EDHOC if isinstance(self.credential, ThingKey) else PSK

    @property
    def id(self) -> bytes:
        """The 16 octets that identify it on the revocation list."""
        return _id(encode(_claims(self)))

    def check_time(self, now: int) -> None:
        """Return if it is valid at `now`.

        Raises:
            ThingOutdated: it has expired, or is not valid yet.
        """
        if now >= self.expires:
            late = now - self.expires
            renew = f"renew it where the authority is: rossec ca thing {self.name} --renew"
            raise ThingOutdated(f"the statement about {self.name} expired {late} s ago", renew)
        if now < self.not_before:
            raise ThingOutdated(
                f"the statement about {self.name} is not valid for another"
                f" {self.not_before - now} s",
                "check the clocks of both computers",
            )


def check_thing_name(name: str) -> str:
    """Return `name` if a thing may have it.

    Raises:
        NameRefused: not an absolute ROS name.
        ThingRefused: that of the authority, a master or a relay, or an alias.
    """
    check_name(name)
    if is_reserved(name) or is_alias(name):
        raise ThingRefused(
            f"{name} cannot be the name of a thing", "choose another, as /things/lamp"
        )
    return name


def sign_statement(signer: Signer, statement: ThingStatement) -> bytes:
    """Sign `statement` with the authority's key; at most `MAX_STATEMENT` octets."""
    return THING.sign(signer, _claims(statement))


def open_statement(
    data: bytes, ca_key: ec.EllipticCurvePublicKey, now: int, *, domain: str
) -> ThingStatement:
    """Verify a statement and read it: of the authority with `ca_key`, for `domain`, valid at `now`.

    Whether it is revoked, and for whose border router it is, is for the caller to check.

    Raises:
        ThingRefused: malformed, or not signed by `ca_key` for `domain`.
        ThingOutdated: not valid at `now`.
    """
    statement = verify_statement(data, ca_key, domain=domain)
    statement.check_time(now)
    return statement


def verify_statement(
    data: bytes, ca_key: ec.EllipticCurvePublicKey, *, domain: str
) -> ThingStatement:
    """As `open_statement`, without checking the time."""
    try:
        body = THING.open_body(data, ca_key, limit=MAX_STATEMENT)
    except (SignatureError, EncodingError) as error:
        raise ThingRefused(f"not a statement of this authority: {error}", _HINT) from None
    statement = _read(body)
    if statement.domain != domain:
        raise ThingRefused(
            f"a thing of the trust domain {statement.domain!r}, not of {domain!r}", _HINT
        )
    return statement


def peek_statement(data: bytes) -> ThingStatement:
    """Read a statement *without* verifying it: to show it.

    Raises:
        ThingRefused: malformed.
    """
    return _read(_body(data))


def statement_id(data: bytes) -> bytes:
    """The 16 octets that identify a statement: the same for every valid signature.

    Raises:
        ThingRefused: malformed.
    """
    body = _body(data)
    _read(body)
    return _id(body)


def _body(data: bytes) -> bytes:
    try:
        return THING.peek_body(data, limit=MAX_STATEMENT)
    except (SignatureError, EncodingError) as error:
        raise ThingRefused(f"not a statement about a thing: {error}", _HINT) from None


def _id(body: bytes) -> bytes:
    return hashlib.sha256(_ID_PREFIX + body).digest()[:ID_SIZE]


def _claims(statement: ThingStatement) -> dict[int | str, Value]:
    claims: dict[int | str, Value] = {
        _SUB: statement.name, _AUD: statement.domain, _EXP: statement.expires,
        _NBF: statement.not_before, _CTI: statement.serial,
        _CNF: write_confirmation(statement.credential), _BORDER: statement.border,
    }  # fmt: skip
    if isinstance(statement.credential, ThingKey) and statement.credential.subject:
        claims[_SUBJECT] = statement.credential.subject
    return claims


def _read(body: bytes) -> ThingStatement:
    try:
        return _statement(decode(body, limit=MAX_STATEMENT))
    except ThingRefused:
        raise
    except CAError as error:
        raise ThingRefused(f"in the statement about a thing: {error}", error.hint) from error


def _statement(payload: Value) -> ThingStatement:
    match payload:
        case {
            2: str() as name, 3: str() as domain, 4: int() as exp, 5: int() as nbf,
            7: bytes() as serial, 8: confirmation, -70035: bytes() as border, **rest,
        } if rest.keys() <= {_SUBJECT}:  # fmt: skip
            subject = rest.get(_SUBJECT, "")
        case _:
            raise ThingRefused("a thing's statement has missing or unknown claims", _HINT)
    if not isinstance(subject, str) or (_SUBJECT in rest and not subject):
        raise ThingRefused("the subject of a thing's credential is empty, or not text", _HINT)
    credential = read_confirmation(confirmation, subject)
    return ThingStatement(domain, name, credential, border, nbf, exp, serial)
