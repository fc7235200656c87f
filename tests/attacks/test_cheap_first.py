"""What is cheap to know is asked first, before a stranger's octets or the record are read."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Final

import pytest

from ca.enrollment.invitation import JoinRequest
from ca.enrollment.join import RefusedMessage, RefuseReason, read
from ca.errors import RevocationRefused
from ca.revocation.lists import RevocationTree, TreeEntries, sign_tree
from ca.revocation.merkle import Tree
from ca.store.record import Store
from rossec.errors import AnswerMalformed
from rossec.federation.site_state import MAX_PARTS, SiteCursor
from tests.rossec.authority.keyservice.test_work import Working
from tests.rossec.master.rights.trust_world import World
from tests.support.authority import DAY

MANY: Final = 1000


class Hashed:
    """Counts the leaves that a tree hashes."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.count = 0
        append = Tree.append

        def counted(tree: Tree, data: bytes) -> None:
            self.count += 1
            append(tree, data)

        monkeypatch.setattr(Tree, "append", counted)

    def taken(self) -> int:
        count, self.count = self.count, 0
        return count


@pytest.fixture
def world() -> World:
    world = World()
    assert world.trust.update(world.site.revoke(), world.now)
    return world


def listing_of(begin: int, count: int = MANY) -> TreeEntries:
    return TreeEntries([number.to_bytes(16) for number in range(begin, begin + count)])


def tree_of(world: World, listing: TreeEntries, seq: int = 90) -> bytes:
    tree = RevocationTree(1, seq, world.now, world.now + DAY, *listing.size_and_root)
    return sign_tree(world.site.signer, tree)


@pytest.mark.attack("invented-entries")
def test_what_is_known_or_too_old_is_refused_before_an_entry_is_hashed(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = listing_of(0), listing_of(5)
    old, new = tree_of(world, first, 90), tree_of(world, second, 91)
    invented = listing_of(9).encoded()
    hashed = Hashed(monkeypatch)
    assert world.trust.update_tree(new, second.encoded(), world.now)
    assert hashed.taken() == MANY
    assert not world.trust.update_tree(new, invented, world.now)
    with pytest.raises(RevocationRefused, match="is older than"):
        world.trust.update_tree(old, first.encoded(), world.now)
    assert hashed.taken() == 0


@pytest.mark.attack("invented-entries")
def test_entries_are_counted_and_those_refused_before_are_known(
    world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    listing = listing_of(0)
    tree, invented = tree_of(world, listing), listing_of(9).encoded()
    shorter = listing_of(0, MANY - 1).encoded()
    unsorted = listing.encoded()[:3] + b"\x50" + bytes([255] * 16) + listing.encoded()[20:]
    hashed = Hashed(monkeypatch)
    for wrong in (shorter, invented[:-1], invented + b"x", b"", b"\x80"):
        with pytest.raises(RevocationRefused, match="not th"):
            world.trust.update_tree(tree, wrong, world.now)
    assert hashed.taken() == 0
    with pytest.raises(RevocationRefused, match="not sorted"):
        world.trust.update_tree(tree, unsorted, world.now)
    assert hashed.taken() == 1
    with pytest.raises(RevocationRefused, match="not those of the signed tree"):
        world.trust.update_tree(tree, invented, world.now)
    assert hashed.taken() == MANY
    with pytest.raises(RevocationRefused, match="refused before"):
        world.trust.update_tree(tree, invented, world.now)
    assert hashed.taken() == 0
    assert world.trust.update_tree(tree, listing.encoded(), world.now)


@pytest.mark.attack("invented-entries")
def test_entries_are_read_in_steps(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    tree, invented = tree_of(world, listing_of(0)), listing_of(9).encoded()
    hashed = Hashed(monkeypatch)
    steps = world.trust.take_tree(tree, invented, world.now)
    for _ in range(MANY // 256):
        next(steps)
        assert hashed.taken() == 256
    with pytest.raises(RevocationRefused, match="not those of the signed tree"):
        next(steps)


@pytest.mark.attack("endless-site")
def test_a_followed_master_that_begins_anew_for_ever_is_given_up() -> None:
    cursor = SiteCursor()
    part = {
        "instance": "a",
        "version": 1,
        "cursor": 1,
        "whole": True,
        "more": True,
        "added": [["node", "/n", "http://h:1/"]],
        "removed": [],
    }
    for _ in range(MAX_PARTS):
        assert cursor.take(part) is None
    with pytest.raises(AnswerMalformed, match="parts"):
        cursor.take(part)


@pytest.mark.attack("unproved-join")
def test_a_request_of_a_stranger_reads_no_revocations(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    working = Working(tmp_path)
    request = JoinRequest.from_bytes(working.request(working.invite()))
    forged = replace(request, transcript=bytes(32)).to_bytes()

    def never(*_: object) -> None:
        raise AssertionError("a stranger has all revocations read")

    with monkeypatch.context() as patched:
        for name in ("revocations", "revoked_entries", "unrevoked_grants", "count_revoked"):
            patched.setattr(Store, name, never, raising=False)
        answer, joined = working.work.join(forged)
    assert read(answer) == RefusedMessage(RefuseReason.REFUSED)
    assert joined is None
    assert working.work.join(request.to_bytes())[1] == "/fleet/a"


@pytest.mark.attack("unproved-join")
def test_the_number_of_revocations_is_counted(tmp_path: Path) -> None:
    working = Working(tmp_path)
    with closing(working.home.store()) as store:
        for number in range(3):
            store.revoke(bytes([number]) * 32, "a test", working.now)
        assert store.count_revoked() == len(store.revoked_entries()) == 3
