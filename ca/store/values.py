"""The rows of the authority's record as values, the life of a request, and the log as a Merkle tree.

A request for an identity is pending, then approved or denied, then issued. An entry of the log is one
action; its leaf is the deterministic CBOR of all its fields, and `digest` binds it to its row. The
*head* is the authority's signature over size and root: only one stored elsewhere prevents the file's
owner from rewriting the log.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NamedTuple, NoReturn

from ca import names, svid
from ca.encoding import encode, is_number
from ca.errors import EncodingError, LogDamaged, SignatureError, StoreError
from ca.keys.signing import Profile, PublicKey, Signer
from ca.revocation import merkle

INTERMEDIATE: Final = "intermediate/"  # prefix of the key; not a prefix of any node name

HOUR: Final = 3600
DAY: Final = 24 * HOUR
MAX_OPEN: Final = 256  # unauthenticated peers can send requests
JOINING: Final = "invitation "  # begins the source of a request that came by an invitation
MAX_JOINING: Final = 192  # open ones of those: the rest is for who enrolls nodes by hand
COLLECTED_AFTER: Final = 30 * DAY  # seconds since it expired
KEPT_EXPIRED: Final = 1024  # expired requests that stay, whatever the clock says

HEAD_PROFILE: Final = Profile("rossec-log+cwt")
MAX_HEAD: Final = 512
_IAT, _SIZE, _ROOT = 6, -70011, -70012

REPLAY_HINT: Final = "somebody changed the record: restore a backup, and find out who"
_HINT: Final = "the record was changed: compare it with a backup, and trust neither until you know why"


class CertificateRow(NamedTuple):
    """One signed identity; times in seconds, inclusive."""

    serial: int
    name: str
    thumbprint: bytes
    der: bytes
    not_before: int
    not_after: int

    @property
    def wildcard(self) -> bool:
        return svid.is_wildcard(self.der)

    def covers(self, name: str) -> bool:
        related = names.covers(self.name, name, wildcard=True)
        return related and (self.name == name or self.wildcard)

    def is_signed_by(self, issuer: "CertificateRow") -> bool:
        by = svid.parse(issuer.der)
        return svid.is_signed_by(svid.parse(self.der), svid.subject(by), svid.key_of(by))


class GrantRow(NamedTuple):
    id: bytes
    name: str
    data: bytes
    not_before: int
    expires: int


class RevocationRow(NamedTuple):
    entry: bytes
    reason: str
    at: int


class RequestState(StrEnum):
    PENDING = "pending"
    APPROVED = "approved"
    DENIED = "denied"
    ISSUED = "issued"

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise StoreError(
            f"the record has a request in an unknown state: {str(value)[:40]!a}",
            "restore it from a backup, and find out who changed it",
        )


# A person approves, the authority issues, and both are recorded separately, as Kubernetes does.
TRANSITIONS: Final[dict[RequestState, frozenset[RequestState]]] = {
    RequestState.PENDING: frozenset({RequestState.APPROVED, RequestState.DENIED}),
    RequestState.APPROVED: frozenset({RequestState.ISSUED, RequestState.DENIED}),
    RequestState.DENIED: frozenset(),
    RequestState.ISSUED: frozenset(),
}
OPEN: Final = frozenset(state for state, following in TRANSITIONS.items() if following)
# Seconds after the last change. A day gives the operator time to answer; an answer is kept for a
# week, so that the node can still fetch it.
RETENTION: Final[dict[RequestState, int]] = {
    RequestState.PENDING: DAY,
    RequestState.APPROVED: DAY,
    RequestState.DENIED: 7 * DAY,
    RequestState.ISSUED: 7 * DAY,
}
_HINTS: Final = {
    RequestState.PENDING: "first approve it: rossec ca approve REQUEST_ID",
    RequestState.APPROVED: "",
    RequestState.DENIED: "if that was a mistake, make a new request on the node",
    RequestState.ISSUED: "one request gets one certificate; to have another: rossec ca renew NAME,"
    " or where it is over rossec ca renew --expired NAME",
}


class RequestRow(NamedTuple):
    digest: bytes  # SHA-256 of `der`
    name: str
    thumbprint: bytes
    der: bytes
    source: str  # where it came from
    arrived: int
    state: RequestState
    reason: str  # of the last change of `state`
    changed: int  # when that was
    replaces: bool = False  # approved although the name has another key
    wildcard: bool = False  # for anonymous nodes too

    @property
    def expires(self) -> int:
        return self.changed + RETENTION[self.state]


def advance(row: RequestRow, state: RequestState, now: int, reason: str = "") -> RequestRow:
    if state not in TRANSITIONS[row.state]:
        raise StoreError(f"the request of {row.name} is {row.state} and cannot be {state}", _HINTS[row.state])
    if now > row.expires:
        raise StoreError(
            f"the request of {row.name} was {row.state} for too long and has expired",
            "make a new request on the node",
        )
    return row._replace(state=state, reason=reason, changed=now)


class LogEntry(NamedTuple):
    number: int
    at: int
    what: str
    subject: str
    detail: str
    digest: bytes  # `digest_of` the row that it is about, or empty


@dataclass(frozen=True)
class Head:
    size: int
    root: bytes
    issued: int


def leaf(entry: LogEntry) -> bytes:
    return encode(list(entry))


def digest_of(row: Sequence[int | str | bytes]) -> bytes:
    return hashlib.sha256(encode(list(row))).digest()


def extend_peaks(peaks: bytes, entry: LogEntry) -> bytes:
    return b"".join(merkle.extend(split_peaks(peaks), entry.number, leaf(entry)))


def split_peaks(peaks: bytes) -> tuple[bytes, ...]:
    return tuple(peaks[start : start + merkle.HASH_SIZE] for start in range(0, len(peaks), merkle.HASH_SIZE))


def check_entries(rows: Iterable[tuple[LogEntry, bytes]]) -> merkle.Tree:
    tree, peaks = merkle.Tree(), b""
    for position, (entry, recorded) in enumerate(rows):
        if entry.number != position:
            raise LogDamaged(f"log entry {position} is missing", _HINT)
        # The peaks are stored with each entry, so that a difference is found where it is.
        peaks = extend_peaks(peaks, entry)
        if peaks != recorded:
            raise LogDamaged(f"log entry {position} was changed", _HINT)
        tree.append(leaf(entry))
    return tree


def check_head(tree: merkle.Tree, head: Head) -> None:
    if head.size > len(tree):
        raise LogDamaged(
            f"the log has {len(tree)} entries where {head.size} were signed: its end is missing", _HINT
        )
    if tree.root(head.size) != head.root:
        raise LogDamaged(f"the first {head.size} entries of the log are not those that were signed", _HINT)


def sign_head(signer: Signer, head: Head) -> bytes:
    return HEAD_PROFILE.sign(signer, {_IAT: head.issued, _SIZE: head.size, _ROOT: head.root})


def open_head(data: bytes, key: PublicKey) -> Head:
    try:
        value = HEAD_PROFILE.open(data, key, limit=MAX_HEAD)
    except (SignatureError, EncodingError) as error:
        raise LogDamaged(f"this is not a signed head of the authority's log: {error}", _HINT) from error
    match value:
        case {6: int() as issued, -70011: int() as size, -70012: bytes() as root, **rest} if (
            not rest and len(root) == merkle.HASH_SIZE and is_number(issued) and is_number(size)
        ):
            return Head(size, root, issued)
        case _:
            raise LogDamaged("the head of the log has missing or unknown fields", _HINT)
