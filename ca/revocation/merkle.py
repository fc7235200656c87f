"""Merkle trees as in Certificate Transparency: roots, and short proofs that a verifier can check.

RFC 6962 section 2.1 defines the hashes, RFC 9162 section 2.1 the verification. The meaning of a
leaf, and the signature and age of a root, are the callers'. An *inclusion* proof shows that a
leaf is at an index; with sorted leaves, the proofs of two adjacent leaves show that an entry
between them is absent. A *consistency* proof shows that a tree extends an older one. Verification
raises on failure.
"""

import hashlib
from collections.abc import Iterable, Sequence
from typing import Final

from ca.errors import CAError

HASH_SIZE: Final = 32
MAX_PROOF: Final = 64  # hashes: enough for a tree of 2^63 leaves
EMPTY_ROOT: Final = hashlib.sha256().digest()


# The prefixes separate leaves from inner nodes (RFC 6962 section 2.1): else an inner node could be given
# out as a leaf, and an entry that nobody wrote be proved.
def leaf_hash(data: bytes) -> bytes:
    return hashlib.sha256(b"\0" + data).digest()


def node_hash(left: bytes, right: bytes) -> bytes:
    return hashlib.sha256(b"\1" + left + right).digest()


class Tree:
    """An append-only tree that stores all hashes; earlier sizes can be queried too."""

    def __init__(self, leaves: Iterable[bytes] = ()) -> None:
        self._levels: list[list[bytes]] = [[]]  # hashes of complete subtrees of 1, 2, 4 ... leaves
        for data in leaves:
            self.append(data)

    def __len__(self) -> int:
        return len(self._levels[0])

    def append(self, data: bytes) -> None:
        digest = leaf_hash(data)
        for level in self._levels:
            level.append(digest)
            if len(level) % 2:
                return
            digest = node_hash(level[-2], level[-1])
        self._levels.append([digest])

    def root(self, size: int | None = None) -> bytes:
        size = self._size(size)
        return self._hash(0, size) if size else EMPTY_ROOT

    def inclusion(self, index: int, size: int | None = None) -> list[bytes]:
        size = self._size(size)
        if not 0 <= index < size:
            raise CAError(f"there is no leaf {index} in a tree of {size}")
        return self._path(index, 0, size)

    def consistency(self, first: int, second: int | None = None) -> list[bytes]:
        second = self._size(second)
        if not 0 < first <= second:
            raise CAError(f"a tree of {second} leaves does not extend one of {first}")
        return self._subproof(first, 0, second, whole=True)

    def _size(self, size: int | None) -> int:
        if size is None:
            return len(self)
        if not 0 <= size <= len(self):
            raise CAError(f"a tree of {len(self)} leaves never had {size}")
        return size

    def _hash(self, start: int, end: int) -> bytes:
        width = end - start
        if width & (width - 1) == 0:
            return self._levels[width.bit_length() - 1][start // width]
        middle = start + _split(width)
        return node_hash(self._hash(start, middle), self._hash(middle, end))

    def _path(self, index: int, start: int, end: int) -> list[bytes]:
        # PATH(index, D[start:end]), RFC 6962 section 2.1.1.
        if end - start == 1:
            return []
        middle = start + _split(end - start)
        if index < middle:
            return [*self._path(index, start, middle), self._hash(middle, end)]
        return [*self._path(index, middle, end), self._hash(start, middle)]

    def _subproof(self, first: int, start: int, end: int, *, whole: bool) -> list[bytes]:
        # SUBPROOF(first, D[start:end], whole), RFC 6962 section 2.1.2; `first` counts from 0.
        if first == end:
            return [] if whole else [self._hash(start, end)]
        middle = start + _split(end - start)
        if first <= middle:
            left = self._subproof(first, start, middle, whole=whole)
            return [*left, self._hash(middle, end)]
        right = self._subproof(first, middle, end, whole=False)
        return [*right, self._hash(start, middle)]


def _split(width: int) -> int:
    return 1 << ((width - 1).bit_length() - 1)


def extend(peaks: Sequence[bytes], size: int, data: bytes) -> tuple[bytes, ...]:
    """The peaks after one more leaf."""
    # The *peaks* of a tree of `size` leaves are the roots of its complete subtrees, the largest first: enough
    # to append to it.
    if len(peaks) != size.bit_count():
        raise CAError(f"a tree of {size} leaves does not have {len(peaks)} peaks")
    grown, digest = list(peaks), leaf_hash(data)
    while size & 1:
        digest = node_hash(grown.pop(), digest)
        size >>= 1
    return (*grown, digest)


def root_of(peaks: Sequence[bytes]) -> bytes:
    if not peaks:
        return EMPTY_ROOT
    *rest, root = peaks
    for peak in reversed(rest):
        root = node_hash(peak, root)
    return root


def verify_inclusion(data: bytes, index: int, size: int, proof: Sequence[bytes], root: bytes) -> None:
    """Return if `proof` shows a leaf with the content `data` at `index` (RFC 9162, 2.1.3.2)."""
    check_form(proof)
    if not 0 <= index < size:
        raise CAError(f"there is no leaf {index} in a tree of {size}")
    number, last, digest = index, size - 1, leaf_hash(data)
    for sibling in proof:
        if last == 0:
            raise CAError("the inclusion proof is too long")
        if number & 1 or number == last:
            digest = node_hash(sibling, digest)
            while not number & 1:  # ends: `number` is not 0 here
                number, last = number >> 1, last >> 1
        else:
            digest = node_hash(digest, sibling)
        number, last = number >> 1, last >> 1
    if last != 0 or digest != root:
        raise CAError("the inclusion proof does not lead to the root")


def check_form(proof: Sequence[bytes]) -> None:
    if len(proof) > MAX_PROOF or any(len(digest) != HASH_SIZE for digest in proof):
        raise CAError(f"a proof is at most {MAX_PROOF} hashes of {HASH_SIZE} bytes")
