"""Revocations too many for a list: the authority signs a Merkle tree, the master sends proofs.

The tree is RFC 6962's over the sorted entries (`ca.revocation.merkle`); the authority signs its
root and size, numbered like a list. The holder of all entries can prove that an entry is present,
or absent: then it would be between two adjacent leaves, or outside the first or last one. So the
master can hide nothing, and a node requests only the entries it needs.
"""

from bisect import bisect_left
from collections.abc import Collection, Generator, Sequence
from dataclasses import dataclass
from typing import Final, TypeVar

from cryptography.hazmat.primitives.asymmetric import ec

from ca.cose import Profile
from ca.encoding import Value, decode, encode, head
from ca.errors import EncodingError, ProofRefused, RevocationRefused, SignatureError
from ca.keys.signer import Signer
from ca.revocation.lists import check_entry
from ca.revocation.merkle import HASH_SIZE, Tree, verify_inclusion

TREE: Final = Profile("rossec-revocation-tree+cwt")
MAX_TREE: Final = 512  # bytes of the statement
MAX_LEAVES: Final = 32 * 1024  # what fits in one call to the master
MAX_TREE_ENTRIES_SIZE: Final = MAX_LEAVES * 34 + 16
MAX_PROOF: Final = 4096

_EXP, _IAT = 4, 6
_EPOCH, _SEQ, _SIZE, _ROOT = -70001, -70002, -70006, -70007
_INT_LIMIT: Final = 1 << 53
_ARRAY: Final = 4 << 5
_SHORT: Final = 17, b"\x50"  # octets of an encoded grant id, and its head
_LONG: Final = 34, b"\x58\x20"  # of a thumbprint
_STEP: Final = 256  # entries; a millisecond
_NO_ENTRIES: Final = "not the entries of a revocation tree"
_NOT_THOSE: Final = (
    "the entries are not those of the signed tree", "deliver it again: rossec ca publish",
)  # fmt: skip
_T = TypeVar("_T")


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
        numbers = (self.epoch, self.seq, self.issued, self.expires, self.size)
        if not all(type(number) is int and 0 <= number < _INT_LIMIT for number in numbers):
            raise RevocationRefused("a number of the revocation tree is out of range")
        if self.expires <= self.issued or not 0 < self.size <= MAX_LEAVES:
            raise RevocationRefused("a revocation tree that is empty, too large, or never valid")
        if len(self.root) != HASH_SIZE:
            raise RevocationRefused(
                f"the root of the revocation tree does not have {HASH_SIZE} bytes"
            )

    @property
    def number(self) -> tuple[int, int]:
        """The order of lists and trees: (epoch, seq)."""
        return self.epoch, self.seq


def is_tree(data: bytes) -> bool:
    """Whether the type of `data` is a tree, not a list; nothing is verified."""
    return data.startswith(_FRAME)


_FRAME: Final = b"\xd2\x84" + encode(TREE.protected)


def sign_tree(signer: Signer, tree: RevocationTree) -> bytes:
    """Sign `tree` with the authority's key."""
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


def open_tree(data: bytes, ca_key: ec.EllipticCurvePublicKey) -> RevocationTree:
    """Verify and read a tree; its age is not checked here.

    Raises:
        RevocationRefused: not signed by the authority, malformed, or not a valid tree.
    """
    try:
        value = TREE.open(data, ca_key, limit=MAX_TREE)
    except (SignatureError, EncodingError) as error:
        raise RevocationRefused(
            f"the revocation tree is refused: {error}", "take it from the authority or the master"
        ) from error
    match value:
        case {4: int() as exp, 6: int() as iat, -70001: int() as epoch, -70002: int() as seq,
              -70006: int() as size, -70007: bytes() as root, **rest} if not rest:  # fmt: skip
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
    """How many entries an encoded array of them has, by its head; where the first begins."""
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
    """The entry that begins there, and where it ends."""
    for size, form in (_SHORT, _LONG):
        end = position + size
        if data.startswith(form, position) and end <= len(data):
            return data[position + len(form) : end], end
    raise RevocationRefused(_NO_ENTRIES)


class TreeEntries:
    """All entries of a tree; creates the proofs.

    Raises:
        RevocationRefused: an invalid entry.
    """

    def __init__(self, entries: Collection[bytes]) -> None:
        self._entries = sorted({check_entry(entry) for entry in entries})
        self._tree = Tree(self._entries)

    @classmethod
    def read(cls, data: bytes) -> "TreeEntries":
        """Read what `encoded` wrote.

        Raises:
            RevocationRefused: it is malformed.
        """
        return finished(cls.reading(data))

    @classmethod
    def reading(
        cls, data: bytes, tree: RevocationTree | None = None
    ) -> Generator[None, None, "TreeEntries"]:
        """As `read` and `check` with `tree`, in steps that each cost little: anybody may send it.

        The number of entries, and what room they take, is compared before any of them is read.
        """
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
        """The entries, encoded for the master."""
        entries: list[Value] = [*self._entries]
        return encode(entries)

    @property
    def entries(self) -> frozenset[bytes]:
        """All of them."""
        return frozenset(self._entries)

    @property
    def size_and_root(self) -> tuple[int, bytes]:
        """What the authority signs."""
        return len(self._entries), self._tree.root()

    def check(self, tree: RevocationTree) -> None:
        """Return if these are the entries of `tree`.

        Raises:
            RevocationRefused: otherwise.
        """
        if self.size_and_root != (tree.size, tree.root):
            raise RevocationRefused(*_NOT_THOSE)

    def prove(self, entry: bytes) -> bytes:
        """The proof that `entry` is in the tree, or that it is not."""
        position = bisect_left(self._entries, entry)
        if position < len(self._entries) and self._entries[position] == entry:
            indexes = [position]
        else:
            indexes = [
                index for index in (position - 1, position) if 0 <= index < len(self._entries)
            ]
        proof: list[Value] = [
            [index, self._entries[index], [*self._tree.inclusion(index)]] for index in indexes
        ]
        return encode(proof)


def is_revoked(tree: RevocationTree, entry: bytes, proof: bytes) -> bool:
    """Whether `proof` shows that `entry` is in `tree`, or that it is not.

    Raises:
        RevocationRefused: it shows neither.
    """
    leaves = [_leaf(tree, part) for part in _parts(proof)]
    match leaves:
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


def _parts(proof: bytes) -> Sequence[Value]:
    try:
        value = decode(proof, limit=MAX_PROOF)
    except EncodingError as error:
        raise RevocationRefused(f"not a proof: {error}") from error
    if not isinstance(value, list):
        raise RevocationRefused("a proof is a list of leaves")
    return value


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
    except ProofRefused as error:
        raise RevocationRefused(f"a proof is invalid: {error}") from error
    return index, leaf
