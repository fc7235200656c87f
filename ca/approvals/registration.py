"""A new passkey, from what `navigator.credentials.create` returned. Pure.

No attestation is asked for, and one that comes is not read: it would say who made the device, not
whose it is. The key must be ES256, the device must have verified its user, and the key is kept in
one form, not as it came. Browsers encode this object in different orders, so `fido2` parses it.
"""

import struct
from hashlib import sha256
from types import ModuleType
from typing import TYPE_CHECKING, Final, NamedTuple

from ca.approvals.assertion import Passkey
from ca.approvals.authenticator import AuthenticatorData, read_key
from ca.approvals.challenges import Challenge
from ca.approvals.client_data import Ceremony, check_client_data
from ca.approvals.statement import MAX_CREDENTIAL, NewPasskey
from ca.encoding import encode
from ca.errors import AssertionMalformed, ConsoleExtraMissing, EncodingError, PasskeyRefused

if TYPE_CHECKING:
    from fido2 import webauthn

MAX_ATTESTATION: Final = 16 * 1024
MAX_NAME: Final = 64
_HINT: Final = "try again, or with another device"
# What its parser raises for bytes that are not of the form.
_MALFORMED: Final = (
    ValueError, LookupError, TypeError, AttributeError, RecursionError, MemoryError, struct.error,
)  # fmt: skip


class Registration(NamedTuple):
    """What the browser returned for a new passkey."""

    client_data: bytes
    attestation: bytes


def register(
    registration: Registration, challenge: Challenge, name: str, at: int, *, approval: bytes = b""
) -> Passkey:
    """The passkey in `registration`, which answers `challenge`.

    Raises:
        AssertionMalformed: not of the form of WebAuthn, or not an ES256 key.
        OtherChallenge, OtherOrigin, NotVerified: as `ca.approvals.assertion.verify`.
        PasskeyRefused: no passkey was made, or it has an impossible name.
        ConsoleExtraMissing: the library is not installed.
    """
    check_client_data(registration.client_data, Ceremony.CREATE, challenge.digest, challenge.origin)
    parsed = _parse(registration.attestation)
    AuthenticatorData.read(bytes(parsed)).check(challenge.rp_id)
    found = parsed.credential_data
    if found is None or not 0 < len(found.credential_id) <= MAX_CREDENTIAL:
        raise PasskeyRefused("the device made no passkey", _HINT)
    return Passkey(
        found.credential_id, check_passkey_name(name), _key(found), bytes(found.aaguid),
        challenge.rp_id, challenge.origin, approval, at,
    )  # fmt: skip


def to_approve(passkey: Passkey) -> NewPasskey:
    """What another phone approves when it adds `passkey`."""
    return NewPasskey(passkey.id, sha256(passkey.cose_key).digest(), passkey.name)


def check_passkey_name(name: str) -> str:
    """Return `name` if a person can read it on one line.

    Raises:
        PasskeyRefused: empty, too long, or with characters that are not printed.
    """
    if not name.strip() or len(name) > MAX_NAME or not name.isprintable():
        raise PasskeyRefused(
            f"the name of a phone has 1 to {MAX_NAME} printable characters",
            "for example: Ann's phone",
        )
    return name


def _parse(attestation: bytes) -> "webauthn.AuthenticatorData":
    if len(attestation) > MAX_ATTESTATION:
        raise AssertionMalformed(f"{len(attestation)} bytes of attestation", _HINT)
    library = _library()
    try:
        data: webauthn.AuthenticatorData = library.AttestationObject(attestation).auth_data
    except _MALFORMED as error:
        raise AssertionMalformed("an attestation of an unknown form", _HINT) from error
    return data


def _key(found: "webauthn.AttestedCredentialData") -> bytes:
    try:
        key = encode(dict(found.public_key))
    except (EncodingError, TypeError) as error:
        raise AssertionMalformed("the device's key is of an unknown form", _HINT) from error
    read_key(key)
    return key


def _library() -> ModuleType:
    """`fido2.webauthn`, which only the extra `console` installs."""
    try:
        from fido2 import webauthn  # noqa: PLC0415
    except ImportError:
        raise ConsoleExtraMissing(
            "passkeys need the package fido2", "pip install 'rossec[console]'"
        ) from None
    return webauthn
