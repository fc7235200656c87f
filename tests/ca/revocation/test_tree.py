"""Proofs of presence and absence, and everything that must not pass for one."""

import hashlib
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ca.encoding import decode, encode
from ca.errors import RevocationRefused
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.lists import (
    MAX_LEAVES,
    TREE,
    RevocationList,
    RevocationTree,
    TreeEntries,
    is_revoked,
    is_tree,
    open_tree,
    sign_list,
    sign_tree,
)
from ca.revocation.merkle import EMPTY_ROOT

CA = KeySigner(generate())
ENTRIES = frozenset(hashlib.sha256(bytes([n])).digest()[: 16 if n % 2 else 32] for n in range(21))
LISTING = TreeEntries(ENTRIES)
TREE_ = RevocationTree(1, 7, 1000, 2000, *LISTING.size_and_root)


def test_every_entry_is_shown_to_be_there() -> None:
    for entry in ENTRIES:
        assert is_revoked(TREE_, entry, LISTING.prove(entry))


@given(st.binary(min_size=16, max_size=16) | st.binary(min_size=32, max_size=32))
def test_any_other_entry_is_proved_absent(entry: bytes) -> None:
    assert is_revoked(TREE_, entry, LISTING.prove(entry)) == (entry in ENTRIES)


@pytest.mark.parametrize("entry", [bytes(16), b"\xff" * 32])
def test_entries_beyond_the_first_and_last_leaf_are_absent(entry: bytes) -> None:
    assert not is_revoked(TREE_, entry, LISTING.prove(entry))


@given(st.frozensets(st.binary(min_size=16, max_size=16), min_size=1, max_size=9), st.data())
def test_trees_of_every_size(entries: frozenset[bytes], data: Any) -> None:
    listing = TreeEntries(entries)
    tree = replace(TREE_, size=listing.size_and_root[0], root=listing.size_and_root[1])
    entry = data.draw(st.sampled_from(sorted(entries)) | st.binary(min_size=16, max_size=16))
    assert is_revoked(tree, entry, listing.prove(entry)) == (entry in entries)


def test_a_revoked_entry_cannot_be_shown_absent() -> None:
    """Whatever leaves a master leaves out: it has no two neighbours with the entry in between."""
    ordered = sorted(ENTRIES)
    entry = ordered[5]
    leaves = [proof_of(leaf)[0] for leaf in ordered]
    for i in range(len(leaves)):
        for chosen in ([leaves[i]], [leaves[i - 1], leaves[i]], [leaves[i - 2], leaves[i]]):
            try:
                assert is_revoked(TREE_, entry, encode([*chosen]))
            except RevocationRefused:
                continue


def proof_of(entry: bytes) -> list[Any]:
    value: Any = decode(LISTING.prove(entry))
    return list(value)


@pytest.mark.parametrize(
    "broken",
    [
        b"",
        encode({}),
        encode([]),
        encode([5]),
        encode([[True, b"x", []]]),
        encode([[0, b"x", [5]]]),
        encode([[0, bytes(16), []]]),
        encode([[99, bytes(16), []]]),
        encode([[0, b"x"]]),
        bytes(5000),
    ],
)
def test_an_invalid_proof_is_refused(broken: bytes) -> None:
    with pytest.raises(RevocationRefused):
        is_revoked(TREE_, bytes(16), broken)


def test_a_proof_of_something_else() -> None:
    first, last = min(ENTRIES), max(ENTRIES)
    with pytest.raises(RevocationRefused, match="does not show the status"):
        is_revoked(TREE_, sorted(ENTRIES)[3], LISTING.prove(last))
    with pytest.raises(RevocationRefused):
        is_revoked(replace(TREE_, root=bytes(32)), first, LISTING.prove(first))
    with pytest.raises(RevocationRefused):
        is_revoked(replace(TREE_, size=22), last, LISTING.prove(last))
    part = proof_of(first)[0]
    with pytest.raises(RevocationRefused):
        is_revoked(TREE_, first, encode([part, part]))


def test_the_statement() -> None:
    data = sign_tree(CA, TREE_)
    assert open_tree(data, CA.public_key) == TREE_
    assert TREE_.number == (1, 7)
    assert is_tree(data)
    listed = sign_list(CA, RevocationList(1, 7, 1, 2, frozenset()))
    assert not is_tree(listed)
    with pytest.raises(RevocationRefused):
        open_tree(listed, CA.public_key)
    with pytest.raises(RevocationRefused):
        open_tree(data, KeySigner(generate()).public_key)


@pytest.mark.parametrize(
    "changes",
    [
        {"epoch": -1},
        {"seq": 1 << 53},
        {"issued": True},
        {"expires": 1000},
        {"size": 0},
        {"size": MAX_LEAVES + 1},
        {"root": bytes(31)},
    ],
)
def test_invalid_trees_are_refused(changes: Any) -> None:
    with pytest.raises(RevocationRefused):
        replace(TREE_, **changes)


def test_unknown_and_missing_fields() -> None:
    claims: Any = TREE.peek(sign_tree(CA, TREE_))
    changes: list[Any] = [{**claims, 99: 1}, {4: 1}, [], {**claims, -70007: "text"}]
    for change in changes:
        with pytest.raises(RevocationRefused, match="missing or unknown fields"):
            open_tree(TREE.sign(CA, change), CA.public_key)


def test_a_listing_is_carried_whole() -> None:
    again = TreeEntries.read(LISTING.encoded())
    assert again.entries == ENTRIES
    again.check(TREE_)
    with pytest.raises(RevocationRefused, match="not those of the signed tree"):
        TreeEntries(sorted(ENTRIES)[1:]).check(TREE_)
    for broken in (b"", encode({}), encode([5]), encode([b"short"])):
        with pytest.raises(RevocationRefused):
            TreeEntries.read(broken)
    assert TreeEntries([]).size_and_root == (0, EMPTY_ROOT)
