"""The own list at the master: accepted, confirmed, sent, and replaced by a tree."""

import pytest

from ca.errors import RevocationRefused
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.lists import (
    RevocationTree,
    TreeEntries,
    digest,
    is_revoked,
    open_timestamp,
    open_tree,
    sign_tree,
)
from grants.document import grant_id
from grants.model import Right
from rossec.master.rights.statements import TrustState
from rossec.master.state.registry import NodeRef
from tests.rossec.master.rights.trust_world import World
from tests.support.authority import DAY, Site


def test_lists_are_persisted_first_and_only_newer_ones_accepted(world: World) -> None:
    old, new = world.site.revoke(), world.site.revoke(world.master)
    assert world.trust.update(new, world.now)
    assert world.persisted[-1] == new
    assert not world.trust.update(new, world.now)
    for bad in (old, Site().revoke(), b"garbage"):
        with pytest.raises(RevocationRefused):
            world.trust.update(bad, world.now)
    assert world.persisted[-1] == new


def test_a_list_that_cannot_be_persisted_is_not_used(world: World) -> None:
    def full(_: bytes) -> None:
        raise OSError("disk full")

    world.trust._persist = full
    with pytest.raises(OSError, match="disk full"):
        world.trust.update(world.site.revoke(world.node), world.now)
    assert world.trust.caller(world.node.identity, world.now).name == "/node"


def test_the_timestamp_is_the_masters_and_of_now(world: World) -> None:
    data, stamp = world.trust.current(world.now + 7)
    signer = world.master.credentials.signer
    assert isinstance(signer, KeySigner)
    opened = open_timestamp(stamp, signer.public_key)
    assert (opened.issued, opened.digest) == (world.now + 7, digest(data))
    assert world.trust.current(world.now + 7)[1] == stamp
    assert world.trust.current(world.now + 8)[1] != stamp


def test_a_node_that_holds_the_list_is_not_sent_it(world: World) -> None:
    data, stamp = world.trust.current(world.now)
    assert world.trust.revocations_for(world.node, world.now) == (data, stamp)
    world.trust.held_lists.record(world.node, digest(data), world.now)
    assert world.trust.revocations_for(world.node, world.now) == (b"", stamp)
    assert world.trust.revocations_for(world.master, world.now) == (data, stamp)
    other = NodeRef("/anonymous", "http://h:1/", world.node.thumbprint)
    assert world.trust.revocations_for(other, world.now) == (data, stamp)
    newer = world.site.revoke(world.master)
    world.trust.update(newer, world.now)
    assert world.trust.revocations_for(world.node, world.now)[0] == newer
    world.trust.held_lists.record(world.node, digest(newer), world.now)
    world.trust.keep_only(frozenset(), world.now)
    assert world.trust.revocations_for(world.node, world.now)[0] == newer


def test_how_far_the_list_in_force_has_come(world: World) -> None:
    data, _ = world.trust.current(world.now)
    both = (world.node, world.master)
    assert world.trust.trust_status(both, world.now)[:2] == (2, 0)
    world.trust.held_lists.record(world.node, digest(data), world.now)
    assert world.trust.trust_status(both, world.now) == (2, 1, (world.master.identity.name,))
    before = world.trust.list_number
    world.trust.update(world.site.revoke(world.master), world.now)
    assert world.trust.list_number == (before[0], before[1] + 1)
    assert world.trust.trust_status(both, world.now).holding == 0


def test_entries_are_not_read_before_the_tree_is_verified(world: World) -> None:
    """Else any enrolled node could make the master hash a megabyte again and again."""
    tree, _ = tree_of(world)
    with pytest.raises(RevocationRefused, match="signature"):
        world.trust.update_tree(tree[:-1] + bytes([tree[-1] ^ 1]), b"no listing", world.now)
    with pytest.raises(RevocationRefused, match="not the entries of"):
        world.trust.update_tree(tree, b"no listing", world.now)


def test_a_tree_replaces_the_list(world: World) -> None:
    data = world.site.grant(world.node, {"/t": Right.PUBLISH})
    world.present(data)
    tree, entries = tree_of(world, grant_id(data))
    with pytest.raises(RevocationRefused, match="needs its entries"):
        world.trust.update(tree, world.now)
    with pytest.raises(RevocationRefused, match="not those of the signed tree"):
        world.trust.update_tree(tree, tree_of(world, bytes(32))[1], world.now)
    assert world.may(Right.PUBLISH, "/t")
    assert world.trust.proofs([bytes(16)]) == []
    assert world.trust.update_tree(tree, entries, world.now)
    assert not world.trust.update_tree(tree, entries, world.now)
    assert world.persisted[-1] == tree
    assert not world.may(Right.PUBLISH, "/t")
    assert world.trust.current(world.now)[0] == tree
    signed = open_tree(tree, world.site.anchor.public_key)
    queried = [grant_id(data), b"x" * 16]
    shown = zip(queried, world.trust.proofs(queried), strict=True)
    assert [is_revoked(signed, entry, proof) for entry, proof in shown] == [True, False]


def test_the_entries_of_a_tree_are_on_the_disk_before_it(world: World) -> None:
    """A master that crashes between the two must not find a tree without entries."""
    order: list[bytes] = []
    world.trust = TrustState(
        world.site.anchor,
        world.master.credentials.signer,
        world.site.revocations(),
        order.append,
        persist_entries=order.append,
    )
    tree, entries = tree_of(world)
    forged = sign_tree(KeySigner(generate()), open_tree(tree, world.site.anchor.public_key))
    with pytest.raises(RevocationRefused):
        world.trust.update_tree(forged, entries, world.now)
    assert order == []
    assert world.trust.update_tree(tree, entries, world.now)
    assert order == [entries, tree]


def tree_of(world: World, *entries: bytes) -> tuple[bytes, bytes]:
    listing = TreeEntries([*entries, *(n.to_bytes(16) for n in range(9))])
    tree = RevocationTree(1, 90, world.now, world.now + DAY, *listing.size_and_root)
    return sign_tree(world.site.signer, tree), listing.encoded()
