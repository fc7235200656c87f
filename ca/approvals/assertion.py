"""A passkey, and an assertion by it, verified against what it had to sign. Pure.

The order is that of Web Authentication section 7.2: type, challenge, origin, no embedding page,
RP id, user present, user verified, counter, signature. Only ES256 is accepted. A passkey that
is synchronized between devices always has the counter 0: what stops a replay is the id of a
statement, which the record takes once.
"""

from hashlib import sha256
from typing import Final, NamedTuple

from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.hashes import SHA256

from ca.approvals.authenticator import AuthenticatorData, read_key
from ca.approvals.client_data import Ceremony, check_client_data
from ca.errors import AssertionForged, AssertionMalformed, PasskeyCloned, PasskeyUnknown

MAX_SIGNATURE: Final = 80  # DER of two integers of 33 bytes needs 72


class Passkey(NamedTuple):
    """A registered passkey.

    `id` is its credential id, `cose_key` its public key as deterministic CBOR, `approval` the id of
    the approval that added it, empty if the terminal did.
    """

    id: bytes
    name: str
    cose_key: bytes
    aaguid: bytes
    rp_id: str
    origin: str
    approval: bytes
    at: int


class Assertion(NamedTuple):
    """What `navigator.credentials.get` returned."""

    credential: bytes
    client_data: bytes
    authenticator_data: bytes
    signature: bytes


def verify(assertion: Assertion, passkey: Passkey, challenge: bytes, counter: int) -> int:
    """The passkey's counter, if it signed `challenge` and its counter was `counter` before.

    Raises:
        PasskeyUnknown: the assertion is of another passkey.
        AssertionMalformed: not of the form of WebAuthn.
        OtherChallenge, OtherOrigin, NotVerified, PasskeyCloned, AssertionForged: as they say.
    """
    if assertion.credential != passkey.id:
        raise PasskeyUnknown("the assertion is of another passkey", "use the one you registered")
    check_client_data(assertion.client_data, Ceremony.GET, challenge, passkey.origin)
    data = AuthenticatorData.read(assertion.authenticator_data)
    data.check(passkey.rp_id)
    if (data.counter or counter) and data.counter <= counter:
        raise PasskeyCloned(
            f"the counter of the passkey {passkey.name!a} is {data.counter} and was {counter}",
            "if it was used once only, somebody has a copy: remove it, and register a new one",
        )
    _check_signature(assertion, passkey)
    return data.counter


def counter_of(authenticator_data: bytes) -> int:
    """The counter in recorded authenticator data.

    Raises:
        AssertionMalformed: it has none.
    """
    return AuthenticatorData.read(authenticator_data).counter


def _check_signature(assertion: Assertion, passkey: Passkey) -> None:
    if len(assertion.signature) > MAX_SIGNATURE:
        raise AssertionMalformed(
            f"a signature of {len(assertion.signature)} bytes", "try again, or with another browser"
        )
    signed = assertion.authenticator_data + sha256(assertion.client_data).digest()
    try:
        read_key(passkey.cose_key).verify(assertion.signature, signed, ec.ECDSA(SHA256()))
    except InvalidSignature:
        raise AssertionForged(
            f"the passkey {passkey.name!a} did not sign this",
            "if you touched it, register it again; else somebody else sent this",
        ) from None
