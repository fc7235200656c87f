"""The known-answer tree of Certificate Transparency, and every tree up to 40 leaves both ways."""

import hashlib
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.errors import CAError
from ca.revocation import merkle
from ca.revocation.merkle import EMPTY_ROOT, Tree, extend, leaf_hash, node_hash, root_of, verify_inclusion
from tests.support.consistency import verify_consistency

# The reference tree of the Certificate Transparency project (merkletree tests of its C++, Go and
# Java logs): contents, and the roots over the first 1, 2 ... 8 of them.
LEAVES = [
    bytes.fromhex(text)
    for text in (
        "",
        "00",
        "10",
        "2021",
        "3031",
        "40414243",
        "5051525354555657",
        "606162636465666768696a6b6c6d6e6f",
    )
]
ROOTS = [
    bytes.fromhex(text)
    for text in (
        "6e340b9cffb37a989ca544e6bb780a2c78901d3fb33738768511a30617afa01d",
        "fac54203e7cc696cf0dfcb42c92a1d9dbaf70ad9e621f4bd8d98662f00e3c125",
        "aeb6bcfe274b70a14fb067a5e5578264db0fa9b51af5e0ba159158f329e06e77",
        "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7",
        "4e3bbb1f7b478dcfe71fb631631519a3bca12c9aefca1612bfce4c13a86264d4",
        "76e67dadbcdf1e10e1b74ddc608abd2f98dfb16fbce75277b5232a127f2087ef",
        "ddb89be403809e325750d3d263cd78929c2942b7942a34b77e122c9594a74c8c",
        "5dc9da79a70659a9ad559cb701ded9a2ab9d823aad2f4960cfe370eff4604328",
    )
]
_96A2 = "96a296d224f285c67bee93c30f8a309157f0daa35dc5b87e410b78630a09cfc7"
_5F08 = "5f083f0a1a33ca076a95279832580db3e0ef4584bdff1f54c8a360f50de3031e"
_6B47 = "6b47aaf29ee3c2af9af889bc1fb9254dabd31177f16232dd6aab035ca39bf6e4"
_BC1A = "bc1a0643b12e4d2d7c77918f44e0f4f79a838b6cf9ec5b5c283e1f4d88599e6b"
_CA85 = "ca854ea128ed050b41b35ffc1b87b8eb2bde461e9e3b5596ece6b9d5975a0ae0"
_0EBC = "0ebc5d3437fbe2db158b9f126a1d118e308181031d0a949f8dededebc558ef6a"
_D37E = "d37ee418976dd95753c1c73862b9398fa2a2cf9b4ff0fdfe8b30cd95209614b7"
INCLUSION = [
    (0, 1, []),
    (0, 8, [_96A2, _5F08, _6B47]),
    (5, 8, [_BC1A, _CA85, _D37E]),
    (2, 3, [ROOTS[1].hex()]),
    (1, 5, [ROOTS[0].hex(), _5F08, _BC1A]),
]
CONSISTENCY = [
    (1, 1, []),
    (1, 8, [_96A2, _5F08, _6B47]),
    (6, 8, [_0EBC, _CA85, _D37E]),
    (2, 5, [_5F08, _BC1A]),
]
TREE = Tree(LEAVES)


def unhex(proof: list[str]) -> list[bytes]:
    return [bytes.fromhex(digest) for digest in proof]


def test_the_reference_roots() -> None:
    assert Tree().root() == EMPTY_ROOT == hashlib.sha256(b"").digest()
    assert [TREE.root(size) for size in range(1, 9)] == ROOTS
    assert [Tree(LEAVES[:size]).root() for size in range(1, 9)] == ROOTS
    assert TREE.root() == ROOTS[7]


@pytest.mark.parametrize(("index", "size", "proof"), INCLUSION)
def test_the_reference_inclusion_proofs(index: int, size: int, proof: list[str]) -> None:
    assert TREE.inclusion(index, size) == unhex(proof)
    verify_inclusion(LEAVES[index], index, size, unhex(proof), ROOTS[size - 1])


@pytest.mark.parametrize(("first", "second", "proof"), CONSISTENCY)
def test_the_reference_consistency_proofs(first: int, second: int, proof: list[str]) -> None:
    assert TREE.consistency(first, second) == unhex(proof)
    verify_consistency(first, second, unhex(proof), ROOTS[first - 1], ROOTS[second - 1])


def by_definition(leaves: list[bytes]) -> bytes:
    """MTH as RFC 6962 writes it."""
    if not leaves:
        return EMPTY_ROOT
    if len(leaves) == 1:
        return leaf_hash(leaves[0])
    k = 1
    while 2 * k < len(leaves):
        k *= 2
    return node_hash(by_definition(leaves[:k]), by_definition(leaves[k:]))


def test_every_size_to_forty() -> None:
    leaves = [str(number).encode() for number in range(40)]
    tree = Tree(leaves)
    peaks: tuple[bytes, ...] = ()
    for size in range(41):
        root = by_definition(leaves[:size])
        assert tree.root(size) == root == root_of(peaks)
        for index in range(size):
            verify_inclusion(leaves[index], index, size, tree.inclusion(index, size), root)
        for first in range(1, size + 1):
            proof = tree.consistency(first, size)
            verify_consistency(first, size, proof, tree.root(first), root)
        if size < 40:
            peaks = extend(peaks, size, leaves[size])


def flipped(digest: bytes) -> bytes:
    return bytes([digest[0] ^ 1]) + digest[1:]


def spoiled(proof: list[bytes]) -> list[list[bytes]]:
    """The proof with one flaw each: a hash changed, left out, or added."""
    changed = [[*proof[:n], flipped(proof[n]), *proof[n + 1 :]] for n in range(len(proof))]
    shorter = [[*proof[:n], *proof[n + 1 :]] for n in range(len(proof))]
    longer = [[*proof, EMPTY_ROOT], [EMPTY_ROOT, *proof]]
    return [*changed, *shorter, *longer]


@pytest.mark.parametrize(("index", "size"), [(0, 1), (0, 8), (5, 8), (6, 7), (4, 5), (2, 6)])
def test_a_wrong_inclusion_is_refused(index: int, size: int) -> None:
    proof, root = TREE.inclusion(index, size), TREE.root(size)
    for wrong in spoiled(proof):
        with pytest.raises(CAError, match=r"the inclusion proof (is too long|does not lead)"):
            verify_inclusion(LEAVES[index], index, size, wrong, root)
    with pytest.raises(CAError, match="does not lead to the root"):
        verify_inclusion(b"other", index, size, proof, root)
    with pytest.raises(CAError, match="does not lead to the root"):
        verify_inclusion(LEAVES[index], index, size, proof, flipped(root))
    for other in set(range(size)) - {index}:
        with pytest.raises(CAError, match=r"the inclusion proof (is too long|does not lead)"):
            verify_inclusion(LEAVES[index], other, size, proof, root)


@pytest.mark.parametrize(("index", "size"), [(-1, 3), (3, 3), (0, 0)])
def test_a_missing_leaf_has_no_proof(index: int, size: int) -> None:
    with pytest.raises(CAError, match=f"there is no leaf {index} in a tree of {size}"):
        TREE.inclusion(index, size)
    with pytest.raises(CAError, match=f"there is no leaf {index} in a tree of {size}"):
        verify_inclusion(b"", index, size, [], EMPTY_ROOT)


@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(range(1, 9), 2)))
def test_a_wrong_continuation_is_refused(first: int, second: int) -> None:
    proof, old, new = TREE.consistency(first, second), TREE.root(first), TREE.root(second)
    for wrong in spoiled(proof):
        with pytest.raises(CAError, match=r"the consistency proof (is too long|does not lead)"):
            verify_consistency(first, second, wrong, old, new)
    for roots in ((flipped(old), new), (old, flipped(new)), (new, old)):
        with pytest.raises(CAError, match="does not lead from the old root"):
            verify_consistency(first, second, proof, *roots)


def test_two_trees_of_one_size() -> None:
    verify_consistency(3, 3, [], ROOTS[2], ROOTS[2])
    for proof, root in (([], ROOTS[3]), ([EMPTY_ROOT], ROOTS[2])):
        with pytest.raises(CAError, match="two trees of the same size have different roots"):
            verify_consistency(3, 3, proof, ROOTS[2], root)


@pytest.mark.parametrize(("first", "second"), [(0, 3), (4, 3), (-1, 3)])
def test_an_empty_or_larger_tree_is_not_extended(first: int, second: int) -> None:
    message = f"a tree of {second} leaves does not extend one of {first}"
    with pytest.raises(CAError, match=message):
        TREE.consistency(first, second)
    with pytest.raises(CAError, match=message):
        verify_consistency(first, second, [], EMPTY_ROOT, EMPTY_ROOT)


def test_an_empty_continuation() -> None:
    with pytest.raises(CAError, match="the consistency proof is empty"):
        verify_consistency(3, 4, [], ROOTS[2], ROOTS[3])


@pytest.mark.parametrize("size", [-1, 9])
def test_states_the_tree_never_had(size: int) -> None:
    with pytest.raises(CAError, match=f"a tree of 8 leaves never had {size}"):
        TREE.root(size)


@pytest.mark.parametrize("proof", [[b""], [bytes(31)], [bytes(32)] * 65])
def test_proofs_have_a_form(proof: list[bytes]) -> None:
    with pytest.raises(CAError, match="a proof is at most 64 hashes of 32 bytes"):
        verify_inclusion(b"", 0, 8, proof, ROOTS[7])
    with pytest.raises(CAError, match="a proof is at most 64 hashes of 32 bytes"):
        verify_consistency(1, 8, proof, ROOTS[0], ROOTS[7])


def test_peaks_fit_their_size() -> None:
    with pytest.raises(CAError, match="a tree of 3 leaves does not have 1 peaks"):
        extend([EMPTY_ROOT], 3, b"")


def test_a_leaf_is_no_node() -> None:
    """Second preimage (RFC 6962 section 2.1): the contents of a node are no leaf with its hash."""
    left, right = leaf_hash(b"a"), leaf_hash(b"b")
    assert leaf_hash(left + right) != node_hash(left, right)


@given(st.lists(st.binary(max_size=3), max_size=60), st.data())
def test_any_tree_proves_itself(leaves: list[bytes], data: st.DataObject) -> None:
    tree = Tree(leaves)
    assert len(tree) == len(leaves)
    size = data.draw(st.integers(0, len(leaves)))
    assert tree.root(size) == merkle.Tree(leaves[:size]).root()


def test_absence_between_two_neighbours() -> None:
    """How the callers show that something is *not* there: sorted leaves, two that are adjacent."""
    words = sorted(hashlib.sha256(bytes([n])).digest() for n in range(20))
    tree = Tree(words)
    absent = hashlib.sha256(b"absent").digest()
    after = next(n for n, word in enumerate(words) if word > absent)
    for index in (after - 1, after):
        verify_inclusion(words[index], index, 20, tree.inclusion(index), tree.root())
    assert words[after - 1] < absent < words[after]
