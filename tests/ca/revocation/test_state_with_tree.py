"""What a node knows where the authority signed a tree instead of a list."""

import pytest

from ca.errors import RevocationRefused, RevocationsStale, Revoked
from ca.revocation.lists import (
    MAX_AGE,
    RevocationList,
    RevocationTree,
    Timestamp,
    TreeEntries,
    digest,
    sign_list,
    sign_tree,
)
from ca.revocation.trust_status import Revocations
from tests.ca.revocation.signed_lists import SIGNER
from tests.support.pki import NOW

ENTRIES = frozenset(n.to_bytes(16) for n in range(1, 40, 3))
LISTING = TreeEntries(ENTRIES)


def tree_data(seq: int = 9) -> bytes:
    return sign_tree(SIGNER, RevocationTree(1, seq, NOW, NOW + 10_000, *LISTING.size_and_root))


def with_tree(seq: int = 9) -> Revocations:
    state = Revocations(SIGNER.public_key)
    data = tree_data(seq)
    state.update(data, NOW)
    state.confirm(Timestamp(seq, digest(data), NOW, MAX_AGE), NOW)
    return state


REVOKED_ONE, OTHER = (4).to_bytes(16), (5).to_bytes(16)


def test_each_entry_of_a_tree_needs_a_proof() -> None:
    state = with_tree()
    for entry in (REVOKED_ONE, OTHER, OTHER):
        with pytest.raises(RevocationsStale, match="no proof received yet"):
            state.check(entry, NOW)
    assert state.unproved == [REVOKED_ONE, OTHER]
    assert state.status_valid_until(OTHER) == NOW + MAX_AGE
    for entry in (REVOKED_ONE, OTHER):
        state.add_proof(entry, LISTING.prove(entry))
    assert state.unproved == []
    state.check(OTHER, NOW)
    with pytest.raises(Revoked):
        state.check(REVOKED_ONE, NOW)
    assert state.entries == {REVOKED_ONE}
    with pytest.raises(RevocationRefused):
        state.add_proof(bytes(16), LISTING.prove(OTHER))


def test_what_was_proved_of_one_tree_is_not_of_the_next() -> None:
    state = with_tree()
    for entry in (REVOKED_ONE, OTHER):
        state.add_proof(entry, LISTING.prove(entry))
    data = tree_data(10)
    assert state.update(data, NOW) == frozenset()
    state.confirm(Timestamp(10, digest(data), NOW + 60, MAX_AGE), NOW + 60)
    with pytest.raises(Revoked):
        state.check(REVOKED_ONE, NOW + 60)
    with pytest.raises(RevocationsStale):
        state.check(OTHER, NOW + 60)
    assert state.status_valid_until(OTHER) == NOW + MAX_AGE
    state.add_proof(OTHER, LISTING.prove(OTHER))
    assert state.status_valid_until(OTHER) == NOW + 60 + MAX_AGE


def test_a_node_with_all_entries_needs_no_proof() -> None:
    state = with_tree()
    with pytest.raises(RevocationRefused, match="not those"):
        state.set_entries(TreeEntries([OTHER]))
    state.set_entries(LISTING)
    state.check(OTHER, NOW)
    with pytest.raises(Revoked):
        state.check(REVOKED_ONE, NOW)
    with pytest.raises(RevocationRefused, match="there is no tree"):
        Revocations(SIGNER.public_key).set_entries(LISTING)


def test_a_list_after_a_tree_says_it_all_again() -> None:
    state = with_tree()
    with pytest.raises(RevocationsStale):
        state.check(OTHER, NOW)
    listed = sign_list(SIGNER, RevocationList(1, 10, NOW, NOW + 10_000, frozenset({REVOKED_ONE})))
    assert state.update(listed, NOW) == {REVOKED_ONE}
    state.add_proof(OTHER, b"which is late")
    assert state.unproved == []
    state.confirm(Timestamp(10, digest(listed), NOW, MAX_AGE), NOW)
    state.check(OTHER, NOW)


def test_what_is_remembered_of_a_tree_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ca.revocation.trust_status.MAX_PROOFS", 2)
    state = with_tree()
    for n in (2, 3, 5):
        with pytest.raises(RevocationsStale):
            state.check(n.to_bytes(16), NOW)
    assert len(state.unproved) == 2
    for n in (2, 3, 5):
        state.add_proof(n.to_bytes(16), LISTING.prove(n.to_bytes(16)))
    state.check((5).to_bytes(16), NOW)
    with pytest.raises(RevocationsStale):
        state.check((2).to_bytes(16), NOW)
