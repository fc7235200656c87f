"""Owners of sockets: shared searches, and verification each time."""

import asyncio
import os
from collections.abc import Iterator

import pytest

from rossec.host import callers, local_sockets
from rossec.host.callers import Process, SocketOwners
from tests.rossec.sidecar.child_programs import programs


@pytest.fixture
def owners() -> SocketOwners:
    return SocketOwners(os.getpid())


@pytest.fixture
def searches(monkeypatch: pytest.MonkeyPatch) -> list[None]:
    """One entry for each search."""
    searches: list[None] = []
    parents = callers.parents

    def counted() -> Iterator[tuple[int, int]]:
        searches.append(None)
        return parents()

    monkeypatch.setattr(callers, "parents", counted)
    return searches


async def test_waiting_callers_share_a_search(
    owners: SocketOwners, searches: list[None], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(callers, "TIME_SLICE", 0.0)  # a fast search would end before the next call
    with programs(4) as several:
        ends = [several.connection(which) for which in range(4) for _ in range(5)]
        inodes = [local_sockets.holder_of(end).inode for end in ends]
        assert all(await asyncio.gather(*map(owners.holds, inodes)))
        assert len(searches) == 2  # all but the first wait for the second search
        assert all([await owners.holds(inode) for inode in inodes])
        assert len(searches) == 2
        for end in ends:
            end.close()


async def test_the_socket_of_another_program_is_not_found(owners: SocketOwners) -> None:
    with programs() as one, one.connection(0) as end:
        inode = local_sockets.holder_of(end).inode
        assert not await SocketOwners(one.running[0].pid).holds(inode)  # it is not its own child
        assert await owners.holds(inode)
        assert not await owners.holds(os.fstat(end.fileno()).st_ino)
        assert not await owners.holds(0)


async def test_a_cached_location_is_verified_again(owners: SocketOwners, searches: list[None]) -> None:
    """The next connection takes the descriptor of one that was closed."""
    with programs() as one:
        with one.connection(0) as end:
            first = local_sockets.holder_of(end).inode
            assert await owners.holds(first)
        one.send_line(0, "close")
        with one.connection(0) as end:
            assert not await owners.holds(first)
            assert await owners.holds(local_sockets.holder_of(end).inode)
    assert len(searches) == 3


async def test_a_reused_pid_is_not_accepted(owners: SocketOwners, monkeypatch: pytest.MonkeyPatch) -> None:
    with programs() as one, one.connection(0) as end:
        inode = local_sockets.holder_of(end).inode
        assert await owners.holds(inode)
        started = [1, 2, 1]  # found by a search, then reused at verification
        monkeypatch.setattr(callers, "process", lambda pid: Process(pid, started.pop()))
        monkeypatch.setattr(callers, "parents", lambda: [(one.running[0].pid, os.getpid())])
        assert not await owners.holds(inode)
        assert started == []


async def test_a_pid_reused_during_verification_is_not_accepted(
    owners: SocketOwners, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Before the check it is the process that was found, afterwards another."""
    with programs() as one, one.connection(0) as end:
        inode = local_sockets.holder_of(end).inode
        calls: list[None] = []
        found = callers.process(one.running[0].pid)
        assert found is not None

        def changing(_: int) -> Process:
            calls.append(None)
            return found if len(calls) < 3 else Process(found.pid, found.started + 1)

        monkeypatch.setattr(callers, "process", changing)
        monkeypatch.setattr(callers, "parents", lambda: [(found.pid, os.getpid())])
        assert not await owners.holds(inode)
        assert len(calls) == 3


async def test_a_cancelled_caller_does_not_cancel_others(
    owners: SocketOwners, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(callers, "TIME_SLICE", 0.0)  # yield after each descriptor
    with programs(2, files=20) as two, two.connection(0) as one, two.connection(1) as other:
        inodes = [local_sockets.holder_of(end).inode for end in (one, other)]
        first, second = (asyncio.ensure_future(owners.holds(inode)) for inode in inodes)
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        first.cancel()
        assert await second
        assert first.cancelled()


async def test_the_location_cache_is_bounded(monkeypatch: pytest.MonkeyPatch, searches: list[None]) -> None:
    monkeypatch.setattr(callers, "REMEMBERED", 1)
    owners = SocketOwners(os.getpid())
    with programs() as one, one.connection(0) as end, one.connection(0) as other:
        for each in (end, other, end):
            assert await owners.holds(local_sockets.holder_of(each).inode)
    assert len(searches) == 3


async def test_the_process_that_holds_a_socket(owners: SocketOwners) -> None:
    with programs(2) as several:
        ends = [several.connection(which) for which in range(2)]
        found = [await owners.process_of(local_sockets.holder_of(end).inode) for end in ends]
        assert [each and each.pid for each in found] == [each.pid for each in several.running]
        assert await owners.process_of(0) is None
        for end in ends:
            end.close()
