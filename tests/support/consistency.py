"""The verification of consistency proofs (RFC 9162, 2.1.4.2), as whoever keeps an older head does it."""

from collections.abc import Sequence

from ca.errors import CAError
from ca.revocation.merkle import check_form, node_hash


def verify_consistency(
    first: int, second: int, proof: Sequence[bytes], first_root: bytes, second_root: bytes
) -> None:
    """Return if `proof` shows that the second tree extends the first (RFC 9162, 2.1.4.2)."""
    check_form(proof)
    if not 0 < first <= second:
        raise CAError(f"a tree of {second} leaves does not extend one of {first}")
    if first == second:
        if proof or first_root != second_root:
            raise CAError("two trees of the same size have different roots")
        return
    _check_growth(first, second, proof, first_root, second_root)


def _check_growth(
    first: int, second: int, proof: Sequence[bytes], first_root: bytes, second_root: bytes
) -> None:
    # The old root is not in the proof: it is prepended when the old tree is a complete subtree.
    path = [first_root, *proof] if first & (first - 1) == 0 else list(proof)
    if not path:
        raise CAError("the consistency proof is empty")
    number, last = first - 1, second - 1
    while number & 1:
        number, last = number >> 1, last >> 1
    old = new = path[0]
    for sibling in path[1:]:
        if last == 0:
            raise CAError("the consistency proof is too long")
        if number & 1 or number == last:
            old, new = node_hash(sibling, old), node_hash(sibling, new)
            while number and not number & 1:
                number, last = number >> 1, last >> 1
        else:
            new = node_hash(new, sibling)
        number, last = number >> 1, last >> 1
    if last != 0 or old != first_root or new != second_root:
        raise CAError("the consistency proof does not lead from the old root to the new one")
