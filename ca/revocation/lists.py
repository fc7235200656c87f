"""The two signed statements of revocation, and their bytes.

The authority signs the *list*: everything revoked, numbered by (epoch, seq), valid for some weeks.
The master signs the *timestamp*: "the list with this digest was the newest at this time", valid
for at most 30 seconds. These are the snapshot and timestamp roles of TUF: the authority's key
stays offline, and a stolen master key can delay revocations but not undo one. Both are maps
without other fields; claims 4 (exp) and 6 (iat) are CWT's (RFC 8392), the negative ones are from
its private range. Entries are sorted, so one set of entries has one encoding.
"""

import hashlib
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.encoding import Value
from ca.errors import EncodingError, RevocationRefused, SignatureError
from ca.keys.publickey import THUMBPRINT_SIZE
from ca.keys.signer import Signer

GRANT_ID_SIZE: Final = 16
DIGEST_SIZE: Final = 32
MAX_ENTRIES: Final = 4096  # for more entries the authority signs a tree
MAX_LIST: Final = MAX_ENTRIES * (THUMBPRINT_SIZE + 2) + 512
MAX_TIMESTAMP: Final = 512
MAX_AGE: Final = 30

LIST_PROFILE: Final = Profile("rossec-revocation+cwt")
TIMESTAMP_PROFILE: Final = Profile("rossec-timestamp+cwt")

_EXP, _IAT = 4, 6
_EPOCH, _SEQ, _ENTRIES, _DIGEST, _MAX_AGE = -70001, -70002, -70003, -70004, -70005
_INT_LIMIT: Final = 1 << 53  # also exact where numbers are floats
_SIZES: Final = (GRANT_ID_SIZE, THUMBPRINT_SIZE)


@dataclass(frozen=True)
class RevocationList:
    """All revocations. Entries are 16-byte grant ids and 32-byte key thumbprints.

    A higher `epoch` (a new authority key, a restored store) beats every `seq` of a lower one.
    """

    epoch: int
    seq: int
    issued: int
    expires: int
    entries: frozenset[bytes]

    @property
    def number(self) -> tuple[int, int]:
        """The order of lists: (epoch, seq)."""
        return self.epoch, self.seq


@dataclass(frozen=True)
class Timestamp:
    """At `issued`, and for `max_age` seconds, the list `seq` with this digest is the newest."""

    seq: int
    digest: bytes
    issued: int
    max_age: int


def digest(data: bytes) -> bytes:
    """Return the digest of a list in a timestamp: SHA-256 of its bytes as received."""
    return hashlib.sha256(data).digest()


def sign_list(signer: Signer, revocations: RevocationList) -> bytes:
    """Sign `revocations` with the authority's key.

    Raises:
        RevocationRefused: an invalid list, as for `open_list`.
    """
    _check_list(revocations)
    entries: list[Value] = [*sorted(revocations.entries)]
    return LIST_PROFILE.sign(
        signer,
        {
            _EXP: revocations.expires,
            _IAT: revocations.issued,
            _EPOCH: revocations.epoch,
            _SEQ: revocations.seq,
            _ENTRIES: entries,
        },
    )


def open_list(data: bytes, ca_key: ec.EllipticCurvePublicKey) -> RevocationList:
    """Verify and read a list; its age is not checked here.

    Raises:
        RevocationRefused: not signed by the authority, malformed, or not a valid list.
    """
    match _open(LIST_PROFILE, data, ca_key, MAX_LIST):
        case {4: exp, 6: iat, -70001: epoch, -70002: seq, -70003: list() as items, **rest} if (
            not rest
        ):
            revocations = RevocationList(
                _number(epoch), _number(seq), _number(iat), _number(exp), _read_entries(items)
            )
        case _:
            raise RevocationRefused("the revocation list has missing or unknown fields")
    _check_list(revocations)
    return revocations


def sign_timestamp(signer: Signer, timestamp: Timestamp) -> bytes:
    """Sign `timestamp` with the master's key.

    Raises:
        RevocationRefused: an invalid timestamp.
    """
    _check_timestamp(timestamp)
    return TIMESTAMP_PROFILE.sign(
        signer,
        {
            _IAT: timestamp.issued,
            _SEQ: timestamp.seq,
            _DIGEST: timestamp.digest,
            _MAX_AGE: timestamp.max_age,
        },
    )


def open_timestamp(data: bytes, key: ec.EllipticCurvePublicKey) -> Timestamp:
    """Verify and read a timestamp; its age is not checked here. `key` is the master's.

    Raises:
        RevocationRefused: not signed by `key`, malformed, or not a valid timestamp.
    """
    match _open(TIMESTAMP_PROFILE, data, key, MAX_TIMESTAMP):
        case {6: iat, -70002: seq, -70004: bytes() as list_digest, -70005: max_age, **rest} if (
            not rest
        ):
            timestamp = Timestamp(_number(seq), list_digest, _number(iat), _number(max_age))
        case _:
            raise RevocationRefused("the timestamp has missing or unknown fields")
    _check_timestamp(timestamp)
    return timestamp


def _open(profile: Profile, data: bytes, key: ec.EllipticCurvePublicKey, limit: int) -> Value:
    try:
        return profile.open(data, key, limit=limit)
    except (SignatureError, EncodingError) as error:
        raise RevocationRefused(
            f"the {profile.typ} statement is refused: {error}",
            "take it from the authority or the master this node trusts",
        ) from error


def _check_list(revocations: RevocationList) -> None:
    for value in (*revocations.number, revocations.issued, revocations.expires):
        _number(value)
    if revocations.expires <= revocations.issued:
        raise RevocationRefused("the revocation list expires before it is issued")
    if len(revocations.entries) > MAX_ENTRIES:
        raise RevocationRefused(
            f"a revocation list of {len(revocations.entries)} entries"
            f" where at most {MAX_ENTRIES} are allowed",
            "make a new authority, or wait until revoked grants have expired",
        )
    for entry in revocations.entries:
        check_entry(entry)


def check_entry(entry: object) -> bytes:
    """Return `entry` if it has the form of a grant id or a key thumbprint.

    Raises:
        RevocationRefused: anything else.
    """
    if not isinstance(entry, bytes) or len(entry) not in _SIZES:
        raise RevocationRefused("an entry is a grant id of 16 bytes or a key thumbprint of 32")
    return entry


def _read_entries(items: list[Value]) -> frozenset[bytes]:
    entries = [check_entry(item) for item in items]
    if any(first >= second for first, second in pairwise(entries)):
        raise RevocationRefused("the entries of the revocation list are not sorted")
    return frozenset(entries)


def _check_timestamp(timestamp: Timestamp) -> None:
    for value in (timestamp.seq, timestamp.issued):
        _number(value)
    if len(timestamp.digest) != DIGEST_SIZE:
        raise RevocationRefused("the timestamp's digest does not have 32 bytes")
    if not 1 <= timestamp.max_age <= MAX_AGE:
        raise RevocationRefused(
            f"a timestamp valid for {timestamp.max_age} s where 1 to {MAX_AGE} are allowed"
        )


def _number(value: object) -> int:
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < _INT_LIMIT:
        raise RevocationRefused("a number in the statement is out of range")
    return value
