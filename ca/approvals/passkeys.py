"""Passkeys: their registration, their assertions, and the approvals that are recorded with them. Pure.

The order of checks is that of Web Authentication section 7.2. Only ES256 is accepted. Everything that
convinced the service is kept: whoever has the record and trusts its passkeys can check later that
every act was approved by a touch.
"""

import base64
import json
import struct
from collections.abc import Iterable
from enum import StrEnum
from hashlib import sha256
from typing import Any, Final, NamedTuple, NoReturn, Self

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256

from ca.approvals.statement import MAX_CREDENTIAL, NewPasskey, Statement
from ca.encoding import decode, encode
from ca.errors import ApprovalRefused, EncodingError

MAX_CLIENT_DATA: Final = 4096

MAX_AUTHENTICATOR_DATA: Final = 2048
_FIXED_SIZE: Final = 37  # a digest, the flags, the counter
_PRESENT, _VERIFIED, _MORE = 0x01, 0x04, 0xC0  # UP, UV; AT and ED: more follows
_COORDINATE: Final = 32
_HINT: Final = "try again, or with another browser"

MAX_SIGNATURE: Final = 80  # DER of two integers of 33 bytes needs 72

MAX_ATTESTATION: Final = 16 * 1024
MAX_NAME: Final = 64
_REGISTRATION_HINT: Final = "try again, or with another device"
# What its parser raises for bytes that are not of the form.
_MALFORMED: Final = (
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    RecursionError,
    MemoryError,
    struct.error,
)


class Ceremony(StrEnum):
    CREATE = "webauthn.create"
    GET = "webauthn.get"


def check_client_data(data: bytes, ceremony: Ceremony, challenge: bytes, origin: str) -> None:
    # Web Authentication section 7.2: the type, the challenge, the origin, no embedding page.
    value = _parse(data)
    # A registration must not serve as an approval, nor the other way round.
    if value.get("type") != ceremony:
        raise ApprovalRefused(f"the passkey was not used for {ceremony}", "try again on the page")
    if value.get("challenge") != base64url(challenge):
        raise ApprovalRefused(
            "the passkey signed something else", "look at the page again: what it shows may have changed"
        )
    if (found := value.get("origin")) != origin:
        raise ApprovalRefused(
            f"the passkey was used at {str(found)[:80]!a} instead of {origin}",
            "open the console by its own address, and register the phone there",
        )
    # In a frame of another page a person sees what that page wants.
    if value.get("crossOrigin", False) is not False or "topOrigin" in value:
        raise ApprovalRefused(
            "the passkey was used inside another page", "open the console in a tab of its own"
        )


def base64url(data: bytes) -> str:
    return base64.urlsafe_b64encode(data).rstrip(b"=").decode()


def _parse(data: bytes) -> dict[str, Any]:
    # Strict JSON. Unknown keys are allowed: browsers add some on purpose (section 5.8.1).
    if len(data) > MAX_CLIENT_DATA:
        raise _malformed(f"{len(data)} bytes of client data")
    try:
        value = json.loads(data.decode(), object_pairs_hook=_unique, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise _malformed("client data that is not JSON") from error
    if not isinstance(value, dict):
        raise _malformed("client data that is no object")
    return value


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    value = dict(pairs)
    if len(value) != len(pairs):
        raise ValueError("a key occurs twice")
    return value


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON")


def _malformed(what: str) -> ApprovalRefused:
    return ApprovalRefused(f"the browser sent {what}", _HINT)


class AuthenticatorData(NamedTuple):
    rp_id_hash: bytes
    flags: int
    counter: int

    @classmethod
    def read(cls, data: bytes) -> "AuthenticatorData":
        if not _FIXED_SIZE <= len(data) <= MAX_AUTHENTICATOR_DATA:
            raise ApprovalRefused(f"{len(data)} bytes of authenticator data", _HINT)
        found = cls(data[:32], data[32], int.from_bytes(data[33:_FIXED_SIZE]))
        if (len(data) > _FIXED_SIZE) != bool(found.flags & _MORE):
            raise ApprovalRefused("authenticator data of another length than it says", _HINT)
        return found

    def check(self, rp_id: str) -> None:
        if self.rp_id_hash != sha256(rp_id.encode()).digest():
            raise ApprovalRefused(
                f"the passkey does not belong to {rp_id}", "register this phone at this console"
            )
        # Verified too: whoever finds a phone that is not locked must not approve with it.
        if not (self.flags & _PRESENT and self.flags & _VERIFIED):
            raise ApprovalRefused(
                "the passkey was used without a finger, face or PIN",
                "set up a screen lock on the device, then try again",
            )


def read_key(cose_key: bytes) -> ec.EllipticCurvePublicKey:
    """The P-256 key for ES256 in a COSE_Key (RFC 9053), which has exactly its five parameters."""
    try:
        match decode(cose_key):
            case {1: 2, 3: -7, -1: 1, -2: bytes(x), -3: bytes(y), **rest} if (
                not rest and len(x) == len(y) == _COORDINATE
            ):
                return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), b"\x04" + x + y)
            case _:
                raise ApprovalRefused("the device's key is not an ES256 key", _HINT)
    except (EncodingError, ValueError) as error:
        raise ApprovalRefused("the device's key is not a key of P-256", _HINT) from error


class Passkey(NamedTuple):
    id: bytes  # its credential id
    name: str
    cose_key: bytes  # its public key as deterministic CBOR
    aaguid: bytes
    rp_id: str
    origin: str
    approval: bytes  # the id of the approval that added it; empty: the terminal did
    at: int


class Assertion(NamedTuple):
    credential: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes


def verify(assertion: Assertion, passkey: Passkey, challenge: bytes, counter: int) -> int:
    """The passkey's counter, if it signed `challenge` and its counter was `counter` before."""
    if assertion.credential != passkey.id:
        raise ApprovalRefused("the assertion is of another passkey", "use the one you registered")
    check_client_data(assertion.client_data, Ceremony.GET, challenge, passkey.origin)
    data = AuthenticatorData.read(assertion.authenticator_data)
    data.check(passkey.rp_id)
    # A passkey that is synchronized between devices always has the counter 0: what stops a replay then is the
    # id of the statement, which the record takes once.
    if (data.counter or counter) and data.counter <= counter:
        raise ApprovalRefused(
            f"the counter of the passkey {passkey.name!a} is {data.counter} and was {counter}",
            "if it was used once only, somebody has a copy: remove it, and register a new one",
        )
    if len(assertion.signature) > MAX_SIGNATURE:
        raise ApprovalRefused(f"a signature of {len(assertion.signature)} bytes", _HINT)
    signed = assertion.authenticator_data + sha256(assertion.client_data).digest()
    try:
        read_key(passkey.cose_key).verify(assertion.signature, signed, ec.ECDSA(SHA256()))
    except InvalidSignature:
        raise ApprovalRefused(
            f"the passkey {passkey.name!a} did not sign this",
            "if you touched it, register it again; else somebody else sent this",
        ) from None
    return data.counter


class Purpose(StrEnum):
    """What a challenge is for: not the first field of any statement, so none is taken for another."""

    LOGIN = "rossec-login-v1"
    PASSKEY = "rossec-passkey-v1"


class Challenge(NamedTuple):
    """One challenge; `id` has 16 random bytes, `until` is its last second."""

    purpose: Purpose
    id: bytes
    domain: str
    origin: str
    rp_id: str
    made: int
    until: int

    @property
    def digest(self) -> bytes:
        return sha256(encode([str(self.purpose), *self[1:]])).digest()


class Registration(NamedTuple):
    client_data: bytes
    attestation: bytes


def register(
    registration: Registration, challenge: Challenge, name: str, at: int, *, approval: bytes = b""
) -> Passkey:
    """The passkey in `registration`, which answers `challenge`."""
    check_client_data(registration.client_data, Ceremony.CREATE, challenge.digest, challenge.origin)
    attestation = registration.attestation
    if len(attestation) > MAX_ATTESTATION:
        raise ApprovalRefused(f"{len(attestation)} bytes of attestation", _REGISTRATION_HINT)
    try:  # browsers encode this object in different orders, so a library parses it
        from fido2 import webauthn  # noqa: PLC0415  (an extra)
    except ImportError:
        raise ApprovalRefused("passkeys need the package fido2", "pip install 'rossec[console]'") from None
    # No attestation is asked for, and one that comes is not read: it would say who made the device.
    try:
        data = webauthn.AttestationObject(attestation).auth_data
    except _MALFORMED as error:
        raise ApprovalRefused("an attestation of an unknown form", _REGISTRATION_HINT) from error
    AuthenticatorData.read(bytes(data)).check(challenge.rp_id)
    found = data.credential_data
    if found is None or not 0 < len(found.credential_id) <= MAX_CREDENTIAL:
        raise ApprovalRefused("the device made no passkey", _REGISTRATION_HINT)
    name = check_passkey_name(name)
    try:
        key = encode(dict(found.public_key))  # in one form, not as it came
    except (EncodingError, TypeError) as error:
        raise ApprovalRefused("the device's key is of an unknown form", _REGISTRATION_HINT) from error
    read_key(key)
    aaguid, rp_id, origin = bytes(found.aaguid), challenge.rp_id, challenge.origin
    return Passkey(found.credential_id, name, key, aaguid, rp_id, origin, approval, at)


def to_approve(passkey: Passkey) -> NewPasskey:
    return NewPasskey(passkey.id, sha256(passkey.cose_key).digest(), passkey.name)


def check_passkey_name(name: str) -> str:
    if not name.strip() or len(name) > MAX_NAME or not name.isprintable():
        raise ApprovalRefused(
            f"the name of a phone has 1 to {MAX_NAME} printable characters", "for example: Ann's phone"
        )
    return name


class Approval(NamedTuple):
    """One approval; `kind` and `subject` are those of its statement."""

    id: bytes
    kind: int
    subject: bytes
    statement: bytes
    payload: bytes
    passkey: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes
    at: int

    @classmethod
    def of(cls, statement: Statement, payload: bytes, assertion: Assertion, at: int) -> Self:
        kind, data = int(statement.kind), statement.to_bytes()
        return cls(statement.id, kind, statement.subject, data, payload, *assertion, at)

    @property
    def assertion(self) -> Assertion:
        return Assertion(self.passkey, self.client_data, self.authenticator_data, self.signature)

    def read(self) -> Statement:
        """The statement, if the other fields agree with it. Signatures: see `ApprovalVerifier`."""
        statement = Statement.from_bytes(self.statement)
        if (self.id, self.kind, self.subject) != (statement.id, int(statement.kind), statement.subject):
            raise ApprovalRefused("the approval is recorded with another's statement", "")
        statement.check_payload(self.payload)
        if not statement.made <= self.at <= statement.until:
            raise ApprovalRefused(
                "the approval did not come in time", "look at the page again, and approve that"
            )
        return statement


class ApprovalVerifier:
    """Verifies approvals, in the order in which they were made; `counters`: those of the passkeys before."""

    def __init__(self, passkeys: Iterable[Passkey], counters: Iterable[tuple[bytes, int]] = ()) -> None:
        self._passkeys = {passkey.id: passkey for passkey in passkeys}
        self._counters = dict(counters)

    def add_passkey(self, passkey: Passkey) -> None:
        self._passkeys[passkey.id] = passkey

    def verify(self, approval: Approval) -> Statement:
        statement = approval.read()
        passkey = self._passkeys.get(approval.passkey)
        if passkey is None:
            raise ApprovalRefused("the passkey of this approval is not known", "is it registered?")
        last = self._counters.get(passkey.id, 0)
        self._counters[passkey.id] = verify(approval.assertion, passkey, statement.challenge, last)
        return statement
