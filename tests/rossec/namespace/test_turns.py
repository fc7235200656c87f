import asyncio

import pytest

from rossec.errors import ServiceFailed
from rossec.namespace.topic_names import CallerTurns

A, B, C = b"a", b"b", b"c"


class Play:
    """Turns that end when the test says so; `having` are those who have one."""

    def __init__(self, places: int, waiting: int = 4) -> None:
        self.turns = CallerTurns(places, waiting)
        self.having: list[bytes] = []
        self.order: list[bytes] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._ends: dict[bytes, asyncio.Event] = {}

    async def ask(self, *callers: bytes) -> list["asyncio.Task[None]"]:
        made = [asyncio.ensure_future(self._turn(caller)) for caller in callers]
        self._tasks += made
        await settle()
        return made

    async def end(self, caller: bytes) -> None:
        self._ends.pop(caller).set()
        await settle()

    async def close(self) -> None:
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        assert self.having == []

    async def _turn(self, caller: bytes) -> None:
        async with self.turns.turn(caller):
            self.having.append(caller)
            self.order.append(caller)
            end = self._ends[caller] = asyncio.Event()
            try:
                await end.wait()
            finally:
                self.having.remove(caller)


async def settle() -> None:
    for _ in range(5):
        await asyncio.sleep(0)


async def test_a_caller_has_one_turn_at_a_time() -> None:
    play = Play(2)
    await play.ask(A, A, A, B)
    assert play.having == [A, B]
    await play.end(B)
    assert play.having == [A]
    await play.end(A)
    assert play.order == [A, B, A]
    await play.close()


async def test_callers_take_turns_however_much_each_of_them_asks() -> None:
    play = Play(1)
    await play.ask(A, A, A, B, B, C)
    for _ in range(5):
        await play.end(play.having[0])
    assert play.order == [A, B, C, A, B, A]
    await play.close()


async def test_too_many_requests_of_one_caller_are_refused() -> None:
    play = Play(1, waiting=2)
    await play.ask(A, A, A)
    (one_more,) = await play.ask(A)
    with pytest.raises(ServiceFailed, match="2 requests of yours wait already"):
        await one_more
    await play.ask(B)
    await play.end(A)
    assert play.having == [B], "another caller was not refused, and is next"
    await play.close()


async def test_who_gives_up_leaves_no_trace() -> None:
    play = Play(1)
    (first, second, third) = await play.ask(A, B, C)
    second.cancel()
    first.cancel()
    await settle()
    assert play.having == [C]
    third.cancel()
    await settle()
    await play.ask(B)
    assert play.having == [B]
    await play.close()
    assert play.turns._queues == {}
    assert play.turns._having == set()


async def test_a_turn_that_is_given_to_one_who_gives_up_is_given_on() -> None:
    play = Play(1)
    first, second, _ = await play.ask(A, B, C)
    play._ends[A].set()
    await asyncio.wait([first])
    second.cancel()  # its turn was given in the same moment
    await settle()
    assert play.having == [C]
    await play.close()
