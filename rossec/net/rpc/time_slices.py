"""Turns on one event loop: long work is done in steps, for one peer after another.

A megabyte of a call takes some hundred milliseconds to parse, and the loop does nothing else meanwhile. So
what is long is a generator that yields after each step, and in each pass of the loop one turn of `TURN`
seconds is given: to the group of peers that has used least, within it to each peer in rotation, and of one
peer to one piece of work after the other. A group is a key, or a foreign domain, whose authority certifies
any number of keys. What is short, timers and what must be cut among it, is done in every pass. But a call
that is short may take long to answer: all that are answered at once in a pass have one turn together, and the
others wait for turns.
"""

import asyncio
from collections import deque
from collections.abc import Callable, Generator, Hashable
from time import monotonic
from typing import Any, Final, Generic, NamedTuple, TypeVar
from weakref import WeakKeyDictionary

from ca.certificates import Identity

TURN: Final = 0.005  # seconds
AT_ONCE: Final = 2 * 1024  # bytes that are parsed without a turn: nearly every call is shorter
ResultT = TypeVar("ResultT")


class TurnOwner(NamedTuple):
    group: Hashable
    peer: Hashable


URGENT: Final = TurnOwner("urgent", "urgent")
"""Work that precedes all other: what a node's master sends, revocations among it."""


def source_of(peer: object) -> TurnOwner:
    """Whose work a call of `peer` is; a peer without a certificate is itself."""
    if isinstance(peer, Identity):
        key = peer.thumbprint
        return TurnOwner(f"domain {peer.domain}" if peer.is_foreign else key, key)
    return TurnOwner(peer, peer)


class _Work(NamedTuple, Generic[ResultT]):
    source: TurnOwner
    steps: Generator[None, None, ResultT]
    result: "asyncio.Future[ResultT]"


class FairQueue:
    """What waits, in the order in which it has its turns: by the time that its group has used.

    The order is that of start-time fair queueing (Goyal, Vin, Cheng 1996): so what needs little
    does not wait for one turn of each group that needs much. A group that had nothing to do does
    not save its time up: it begins where the others are.
    """

    def __init__(self) -> None:
        self._groups: dict[Hashable, dict[Hashable, deque[_Work[Any]]]] = {}
        self._used: dict[Hashable, float] = {}  # by group, more than `_least`
        self._least = 0.0

    def __bool__(self) -> bool:
        return bool(self._groups)

    def add(self, work: _Work[Any], *, first: bool = False) -> None:
        queue = self._groups.setdefault(work.source.group, {}).setdefault(work.source.peer, deque())
        (queue.appendleft if first else queue.append)(work)

    def charge(self, group: Hashable, seconds: float) -> None:
        # The group has used so much; that is forgotten when nobody waits.
        self._used[group] = self._used.get(group, self._least) + seconds

    def has_used_more(self, group: Hashable) -> bool:
        return group in self._used

    def take(self) -> _Work[Any]:
        if URGENT.group in self._groups:
            group = URGENT.group
        else:
            used, least = self._used, self._least
            group = min(self._groups, key=lambda each: used.get(each, least))
            self._least = used.get(group, least)
        peers = self._groups.pop(group)
        peer = next(iter(peers))
        queue = peers.pop(peer)
        work = queue.popleft()
        if queue:
            peers[peer] = queue
        if peers:
            self._groups[group] = peers
        return work

    def forget_used(self) -> None:
        used = self._used if self._groups else {}
        self._used = {group: spent for group, spent in used.items() if spent > self._least}


class LoopTurns:
    def __init__(self, clock: Callable[[], float] = monotonic, length: float = TURN) -> None:
        self._clock = clock
        self._length = length
        self._loop = asyncio.get_running_loop()
        self._waiting = FairQueue()
        self._due = False
        self._pass_ends: float | None = None
        self._spent = 0.0  # seconds in this pass, for what was done at once

    async def run(self, source: TurnOwner, steps: Generator[None, None, ResultT]) -> ResultT:
        work = _Work(source, steps, self._loop.create_future())
        self._waiting.add(work)
        if not self._due:
            self._due = True
            self._loop.call_soon(self._turn)
        try:
            result: ResultT = await work.result
        finally:
            steps.close()
        return result

    async def wait(self, source: TurnOwner) -> None:
        await self.run(source, (None for _ in ()))

    def has_time(self, source: Callable[[], TurnOwner]) -> bool:
        # Not if others wait who have used less than it has.
        if self._waiting and self._waiting.has_used_more(source().group):
            return False
        return self._spent < self._length

    def spend(self, source: Callable[[], TurnOwner], seconds: float) -> None:
        # Something was done at once, which took so long.
        if not self._spent:
            self._loop.call_soon(self._next_pass)
        self._spent += seconds
        if seconds >= self._length:
            self._waiting.charge(source().group, seconds)

    def first(self) -> Callable[[], bool]:
        # All that is begun so in one pass of the loop has one turn together.
        if self._pass_ends is None:
            self._pass_ends = self._clock() + self._length
            self._loop.call_soon(self._next_pass)
        ends = self._pass_ends
        return lambda: bool(self._waiting) or self._clock() >= ends

    def _next_pass(self) -> None:
        self._pass_ends = None
        self._spent = 0.0
        if not self._due:
            self._waiting.forget_used()

    def _turn(self) -> None:
        began = self._clock()
        ends = began + self._length
        while self._waiting:
            work = self._waiting.take()
            if not work.result.done():  # else nobody waits for it any more
                self._advance(work, ends)
            now = self._clock()
            self._waiting.charge(work.source.group, now - began)
            began = now
            if now >= ends:
                break
        self._waiting.forget_used()
        self._due = bool(self._waiting)
        if self._due:
            self._loop.call_soon(self._turn)

    def _advance(self, work: _Work[Any], ends: float) -> None:
        try:
            while True:
                next(work.steps)
                if self._clock() >= ends:
                    self._waiting.add(work, first=True)
                    return
        except StopIteration as end:
            work.result.set_result(end.value)
        except Exception as error:  # noqa: BLE001 - raised where it is waited for
            work.result.set_exception(error)


_shared: "WeakKeyDictionary[asyncio.AbstractEventLoop, LoopTurns]" = WeakKeyDictionary()


def of_loop() -> LoopTurns:
    """The turns of the running loop: all long work on it shares them."""
    loop = asyncio.get_running_loop()
    turns = _shared.get(loop)
    if turns is None:
        turns = _shared[loop] = LoopTurns()
    return turns
