"""The signed statements of revocation, their bytes, and proofs of single entries.

The authority signs the *list*: everything revoked, numbered by (epoch, seq), valid for some weeks.
The master signs the *timestamp*: "the list with this digest was the newest at this time" (the
snapshot and timestamp roles of TUF). Where the entries are too many, the authority signs a Merkle
*tree* over them instead, sorted, and the master proves that an entry is present, or absent.
"""

import hashlib
from bisect import bisect_left
from collections.abc import Collection, Generator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, TypeVar

from ca.encoding import Value, decode, encode, head, is_number
from ca.errors import CAError, EncodingError, RevocationRefused, SignatureError
from ca.keys.signing import THUMBPRINT_SIZE, Profile, PublicKey, Signer
from ca.revocation.merkle import HASH_SIZE, Tree, verify_inclusion

GRANT_ID_SIZE: Final = 16
DIGEST_SIZE: Final = 32
MAX_ENTRIES: Final = 4096  # for more entries the authority signs a tree
MAX_LIST: Final = MAX_ENTRIES * (THUMBPRINT_SIZE + 2) + 512
MAX_TIMESTAMP: Final = 512
# Seconds. A stolen master key can delay revocations by so much, and not undo one; a node whose master is
# down is refused after it.
MAX_AGE: Final = 30

LIST_PROFILE: Final = Profile("rossec-revocation+cwt")
TIMESTAMP_PROFILE: Final = Profile("rossec-timestamp+cwt")

_EXP, _IAT = 4, 6
_EPOCH, _SEQ, _ENTRIES, _DIGEST, _MAX_AGE = -70001, -70002, -70003, -70004, -70005
_SIZES: Final = (GRANT_ID_SIZE, THUMBPRINT_SIZE)

TREE: Final = Profile("rossec-revocation-tree+cwt")
MAX_TREE: Final = 512  # bytes of the statement
MAX_LEAVES: Final = 32 * 1024  # what fits in one call to the master
MAX_TREE_ENTRIES_SIZE: Final = MAX_LEAVES * 34 + 16
MAX_PROOF: Final = 4096

_SIZE, _ROOT = -70006, -70007
_ARRAY: Final = 4 << 5
_SHORT: Final = 17, b"\x50"  # octets of an encoded grant id, and its head
_LONG: Final = 34, b"\x58\x20"  # of a thumbprint
_STEP: Final = 256  # entries; a millisecond
_NO_ENTRIES: Final = "not the entries of a revocation tree"
_NOT_THOSE: Final = ("the entries are not those of the signed tree", "deliver it again: rossec ca publish")
_T = TypeVar("_T")

_FRAME: Final = b"\xd2\x84" + encode(TREE.protected)


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
        return self.epoch, self.seq


@dataclass(frozen=True)
class Timestamp:
    """At `issued`, and for `max_age` seconds, the list `seq` with this digest is the newest."""

    seq: int
    digest: bytes
    issued: int
    max_age: int


def digest(data: bytes) -> bytes:
    """The digest of a list in a timestamp: SHA-256 of its bytes as received."""
    return hashlib.sha256(data).digest()


def sign_list(signer: Signer, revocations: RevocationList) -> bytes:
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


def open_list(data: bytes, ca_key: PublicKey) -> RevocationList:
    """Verify and read a list; its age is not checked here."""
    match _open(LIST_PROFILE, data, ca_key, MAX_LIST):
        case {4: exp, 6: iat, -70001: epoch, -70002: seq, -70003: list() as items, **rest} if not rest:
            entries = [check_entry(item) for item in items]
            # Sorted, without doubles: one list has one encoding, and so one digest in timestamps.
            if any(first >= second for first, second in pairwise(entries)):
                raise RevocationRefused("the entries of the revocation list are not sorted")
            epoch, seq, iat, exp = map(_number, (epoch, seq, iat, exp))
            revocations = RevocationList(epoch, seq, iat, exp, frozenset(entries))
        case _:
            raise RevocationRefused("the revocation list has missing or unknown fields")
    _check_list(revocations)
    return revocations


def sign_timestamp(signer: Signer, timestamp: Timestamp) -> bytes:
    _check_timestamp(timestamp)
    return TIMESTAMP_PROFILE.sign(
        signer,
        {_IAT: timestamp.issued, _SEQ: timestamp.seq, _DIGEST: timestamp.digest, _MAX_AGE: timestamp.max_age},
    )


def open_timestamp(data: bytes, key: PublicKey) -> Timestamp:
    """Verify and read a timestamp; its age is not checked here. `key` is the master's."""
    match _open(TIMESTAMP_PROFILE, data, key, MAX_TIMESTAMP):
        case {6: iat, -70002: seq, -70004: bytes() as list_digest, -70005: max_age, **rest} if not rest:
            timestamp = Timestamp(_number(seq), list_digest, _number(iat), _number(max_age))
        case _:
            raise RevocationRefused("the timestamp has missing or unknown fields")
    _check_timestamp(timestamp)
    return timestamp


def _open(profile: Profile, data: bytes, key: PublicKey, limit: int) -> Value:
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
    if not isinstance(entry, bytes) or len(entry) not in _SIZES:
        raise RevocationRefused("an entry is a grant id of 16 bytes or a key thumbprint of 32")
    return entry


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
    if not is_number(value):
        raise RevocationRefused("a number in the statement is out of range")
    return value


@dataclass(frozen=True)
class RevocationTree:
    """All revocations, as the size and the root of their tree; numbered like a list."""

    epoch: int
    seq: int
    issued: int
    expires: int
    size: int
    root: bytes

    def __post_init__(self) -> None:
        if not all(map(is_number, (*self.number, self.issued, self.expires, self.size))):
            raise RevocationRefused("a number of the revocation tree is out of range")
        if self.expires <= self.issued or not 0 < self.size <= MAX_LEAVES:
            raise RevocationRefused("a revocation tree that is empty, too large, or never valid")
        if len(self.root) != HASH_SIZE:
            raise RevocationRefused(f"the root of the revocation tree does not have {HASH_SIZE} bytes")

    @property
    def number(self) -> tuple[int, int]:
        return self.epoch, self.seq


def is_tree(data: bytes) -> bool:
    """Whether the type of `data` is a tree, not a list; nothing is verified."""
    return data.startswith(_FRAME)


def sign_tree(signer: Signer, tree: RevocationTree) -> bytes:
    return TREE.sign(
        signer,
        {
            _EXP: tree.expires,
            _IAT: tree.issued,
            _EPOCH: tree.epoch,
            _SEQ: tree.seq,
            _SIZE: tree.size,
            _ROOT: tree.root,
        },
    )


def open_tree(data: bytes, ca_key: PublicKey) -> RevocationTree:
    try:
        value = TREE.open(data, ca_key, limit=MAX_TREE)
    except (SignatureError, EncodingError) as error:
        raise RevocationRefused(
            f"the revocation tree is refused: {error}", "take it from the authority or the master"
        ) from error
    match value:
        case {
            4: int() as exp,
            6: int() as iat,
            -70001: int() as epoch,
            -70002: int() as seq,
            -70006: int() as size,
            -70007: bytes() as root,
            **rest,
        } if not rest:
            return RevocationTree(epoch, seq, iat, exp, size, root)
        case _:
            raise RevocationRefused("the revocation tree has missing or unknown fields")


def finished(steps: Generator[None, None, _T]) -> _T:
    """What the steps return, all of them done at once."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            result: _T = end.value
            return result


def _count(data: bytes) -> tuple[int, int]:
    if len(data) > MAX_TREE_ENTRIES_SIZE:
        raise RevocationRefused("too many entries for a revocation tree")
    for length in (1, 2, 3):
        size = data[0] & 31 if length == 1 and data else int.from_bytes(data[1:length])
        room = len(data) - length
        if size <= MAX_LEAVES and data[:length] == head(_ARRAY, size):
            if room % _SHORT[0] or not size * _SHORT[0] <= room <= size * _LONG[0]:
                break  # the long form has twice the room of the short one
            return size, length
    raise RevocationRefused(_NO_ENTRIES)


def _entry(data: bytes, position: int) -> tuple[bytes, int]:
    for size, form in (_SHORT, _LONG):
        end = position + size
        if data.startswith(form, position) and end <= len(data):
            return data[position + len(form) : end], end
    raise RevocationRefused(_NO_ENTRIES)


class TreeEntries:
    def __init__(self, entries: Collection[bytes]) -> None:
        self._entries = sorted({check_entry(entry) for entry in entries})
        self._tree = Tree(self._entries)

    @classmethod
    def read(cls, data: bytes) -> "TreeEntries":
        return finished(cls.reading(data))

    @classmethod
    def reading(cls, data: bytes, tree: RevocationTree | None = None) -> Generator[None, None, "TreeEntries"]:
        """As `read` and `check` with `tree`, in steps that each cost little: anybody may send it."""
        # The number of entries, and what room they take, is compared before any of them is read.
        size, position = _count(data)
        if tree is not None and tree.size != size:
            raise RevocationRefused(*_NOT_THOSE)
        found = cls(())
        for number in range(size):
            entry, position = _entry(data, position)
            if found._entries and entry <= found._entries[-1]:
                raise RevocationRefused("the entries of a revocation tree are not sorted")
            found._entries.append(entry)
            found._tree.append(entry)
            if number % _STEP == _STEP - 1:
                yield
        if position != len(data):
            raise RevocationRefused(_NO_ENTRIES)
        if tree is not None:
            found.check(tree)
        return found

    def encoded(self) -> bytes:
        entries: list[Value] = [*self._entries]
        return encode(entries)

    @property
    def entries(self) -> frozenset[bytes]:
        return frozenset(self._entries)

    @property
    def size_and_root(self) -> tuple[int, bytes]:
        return len(self._entries), self._tree.root()

    def check(self, tree: RevocationTree) -> None:
        if self.size_and_root != (tree.size, tree.root):
            raise RevocationRefused(*_NOT_THOSE)

    def prove(self, entry: bytes) -> bytes:
        position = bisect_left(self._entries, entry)
        if position < len(self._entries) and self._entries[position] == entry:
            indexes = [position]
        else:
            indexes = [at for at in (position - 1, position) if 0 <= at < len(self._entries)]
        return encode([[at, self._entries[at], [*self._tree.inclusion(at)]] for at in indexes])


def is_revoked(tree: RevocationTree, entry: bytes, proof: bytes) -> bool:
    try:
        parts = decode(proof, limit=MAX_PROOF)
    except EncodingError as error:
        raise RevocationRefused(f"not a proof: {error}") from error
    if not isinstance(parts, list):
        raise RevocationRefused("a proof is a list of leaves")
    # With sorted leaves, an entry is absent if it lies before the first one, behind the last one, or between
    # two neighbours: the master can hide nothing.
    match [_leaf(tree, part) for part in parts]:
        case [(_, leaf)] if leaf == entry:
            return True
        case [(0, first)] if entry < first:
            return False
        case [(index, last)] if index == tree.size - 1 and last < entry:
            return False
        case [(left, below), (right, above)] if right == left + 1 and below < entry < above:
            return False
        case _:
            raise RevocationRefused("the proof does not show the status of this entry")


def _leaf(tree: RevocationTree, part: Value) -> tuple[int, bytes]:
    match part:
        case [int() as index, bytes() as leaf, list() as hashes] if type(index) is int:
            path = [item for item in hashes if isinstance(item, bytes)]
        case _:
            raise RevocationRefused("a leaf of a proof is [index, entry, hashes]")
    if len(path) != len(hashes):
        raise RevocationRefused("the hashes of a proof are bytes")
    try:
        verify_inclusion(leaf, index, tree.size, path, tree.root)
    except CAError as error:
        raise RevocationRefused(f"a proof is invalid: {error}") from error
    return index, leaf
