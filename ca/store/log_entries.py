"""The log of everything the authority did, as leaves of a Merkle tree, and its signed heads.

An *entry* is one action; its leaf is the deterministic CBOR of all its fields, and `digest` binds
it to the row it is about. The tree's peaks are stored with each entry, so that a difference is
found at the entry where it is. The *head* is the authority's signature over size and root: triggers
prevent mistakes, but only a head stored elsewhere prevents the file's owner from rewriting the log.
"""

import hashlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.encoding import Value, encode
from ca.errors import EncodingError, LogDamaged, SignatureError
from ca.keys.signer import Signer
from ca.revocation import merkle
from ca.revocation.merkle import HASH_SIZE

HEAD_PROFILE: Final = Profile("rossec-log+cwt")
MAX_HEAD: Final = 512
_IAT, _SIZE, _ROOT = 6, -70011, -70012
_INT_LIMIT: Final = 1 << 53


class LogEntry(NamedTuple):
    """One action: its number, time, kind, subject, details, and the digest of its data.

    `digest` is `digest_of` the row this entry is about, or empty.
    """

    number: int
    at: int
    what: str
    subject: str
    detail: str
    digest: bytes


@dataclass(frozen=True)
class Head:
    """The state of the log at `issued`: number of entries, and root."""

    size: int
    root: bytes
    issued: int


def leaf(entry: LogEntry) -> bytes:
    """The content of the entry's leaf."""
    return encode(list(entry))


def digest_of(row: Sequence[int | str | bytes]) -> bytes:
    """The digest of a row of the record in an entry."""
    return hashlib.sha256(encode(list(row))).digest()


def extend_peaks(peaks: bytes, entry: LogEntry) -> bytes:
    """The concatenated peaks after `entry`; those before it are `peaks`."""
    return b"".join(merkle.extend(split_peaks(peaks), entry.number, leaf(entry)))


def split_peaks(peaks: bytes) -> tuple[bytes, ...]:
    """The list of concatenated `peaks`."""
    return tuple(peaks[start : start + HASH_SIZE] for start in range(0, len(peaks), HASH_SIZE))


def check_entries(rows: Iterable[tuple[LogEntry, bytes]]) -> merkle.Tree:
    """Return the tree of all entries, each given with the peaks recorded with it.

    Raises:
        LogDamaged: names the first entry that was changed.
    """
    tree, peaks = merkle.Tree(), b""
    for position, (entry, recorded) in enumerate(rows):
        if entry.number != position:
            raise LogDamaged(f"log entry {position} is missing", _HINT)
        peaks = extend_peaks(peaks, entry)
        if peaks != recorded:
            raise LogDamaged(f"log entry {position} was changed", _HINT)
        tree.append(leaf(entry))
    return tree


def check_head(tree: merkle.Tree, head: Head) -> None:
    """Return if the log extends this head.

    Raises:
        LogDamaged: it was truncated or rewritten since.
    """
    if head.size > len(tree):
        raise LogDamaged(
            f"the log has {len(tree)} entries where {head.size} were signed: its end is missing",
            _HINT,
        )
    if tree.root(head.size) != head.root:
        raise LogDamaged(
            f"the first {head.size} entries of the log are not those that were signed", _HINT
        )


def sign_head(signer: Signer, head: Head) -> bytes:
    """Sign `head` with the authority's key."""
    return HEAD_PROFILE.sign(signer, {_IAT: head.issued, _SIZE: head.size, _ROOT: head.root})


def open_head(data: bytes, key: ec.EllipticCurvePublicKey) -> Head:
    """Verify and read a head.

    Raises:
        LogDamaged: not signed by the authority, or not a head.
    """
    try:
        value = HEAD_PROFILE.open(data, key, limit=MAX_HEAD)
    except (SignatureError, EncodingError) as error:
        raise LogDamaged(
            f"this is not a signed head of the authority's log: {error}", _HINT
        ) from error
    return _read_head(value)


def _read_head(value: Value) -> Head:
    match value:
        case {6: int() as issued, -70011: int() as size, -70012: bytes() as root, **rest} if (
            not rest and len(root) == HASH_SIZE and all(_in_range(n) for n in (issued, size))
        ):
            return Head(size, root, issued)
        case _:
            raise LogDamaged("the head of the log has missing or unknown fields", _HINT)


def _in_range(number: int) -> bool:
    return not isinstance(number, bool) and 0 <= number < _INT_LIMIT


_HINT: Final = (
    "the record was changed: compare it with a backup, and trust neither until you know why"
)
