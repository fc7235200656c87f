"""Turns on a loop: each group of peers has one share, and what is short never waits."""

import asyncio
from collections.abc import Generator

import pytest

from rossec.net.rpc.time_slices import URGENT, LoopTurns, TurnOwner, of_loop, source_of
from tests.rossec.net.rpc.clocks import Ticks


def steps(log: list[str], name: str, count: int = 3) -> Generator[None, None, str]:
    for number in range(count):
        log.append(name)
        if number < count - 1:
            yield
    return name


def own(name: str) -> TurnOwner:
    return TurnOwner(name, name)


async def test_each_peer_has_a_turn_before_the_next_of_the_first() -> None:
    """Every step takes a whole turn."""
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    found = await asyncio.gather(
        *(turns.run(own("many"), steps(log, f"m{number}", 2)) for number in range(20)),
        turns.run(own("one"), steps(log, "one", 3)),
    )
    assert found == [f"m{number}" for number in range(20)] + ["one"]
    assert log[:6] == ["m0", "one", "m0", "one", "m1", "one"]


async def test_a_domain_of_many_keys_has_one_share() -> None:
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    await asyncio.gather(
        *(turns.run(TurnOwner("domain", number), steps(log, "far", 2)) for number in range(20)),
        turns.run(own("near"), steps(log, "near", 4)),
    )
    assert log[:8] == ["far", "near"] * 4


async def test_peers_of_one_domain_share_its_turns() -> None:
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    await asyncio.gather(
        *(turns.run(TurnOwner("domain", "a"), steps(log, "a", 2)) for _ in range(20)),
        turns.run(TurnOwner("domain", "b"), steps(log, "b", 2)),
    )
    assert log[:4] == ["a", "b", "a", "b"]


async def test_who_has_used_little_does_not_wait_for_those_who_used_much() -> None:
    """Not for one turn of each: a newcomer's short work is next, again and again."""
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    many = [asyncio.ensure_future(turns.run(own(f"{n}"), steps(log, "x", 9))) for n in range(20)]
    for number in range(5):
        for _ in range(20):
            await asyncio.sleep(0)
        before = len(log)
        await turns.run(own(f"new{number}"), steps(log, "new", 1))
        assert len(log) <= before + 3
    await asyncio.gather(*many)


async def test_what_a_group_has_used_is_forgotten() -> None:
    """Else the table would have an entry of each key that ever called."""
    turns = LoopTurns(Ticks(), length=1)
    works = [turns.run(own(f"{n}"), steps([], "x", 3)) for n in range(100)]
    await asyncio.gather(*works)
    turns.spend(lambda: own("y"), 5)
    await asyncio.sleep(0)
    assert not turns._waiting._used


async def test_what_is_done_at_once_has_one_turn_in_a_pass() -> None:
    turns, who = LoopTurns(Ticks(), length=3), lambda: own("x")
    assert turns.has_time(who)
    turns.spend(who, 1)
    assert turns.has_time(who)
    turns.spend(who, 2)
    assert not turns.has_time(who)
    await asyncio.sleep(0)
    assert turns.has_time(who)


async def test_who_has_used_much_does_nothing_at_once_while_others_wait() -> None:
    turns = LoopTurns(Ticks(), length=1)
    work = asyncio.ensure_future(turns.run(own("long"), steps([], "x", 50)))
    await asyncio.sleep(0)
    turns.spend(lambda: own("greedy"), 100)
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert not turns.has_time(lambda: own("greedy"))
    assert turns.has_time(lambda: own("other"))
    work.cancel()


async def test_what_is_urgent_precedes_everything() -> None:
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    waiting = [turns.run(own(f"{number}"), steps(log, "x", 5)) for number in range(9)]
    await asyncio.gather(*waiting, turns.run(URGENT, steps(log, "urgent", 4)))
    assert log[:4] == ["urgent"] * 4


async def test_the_loop_goes_on_between_two_turns() -> None:
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    work = asyncio.ensure_future(turns.run(own("long"), steps(log, "long", 50)))
    for number in range(10):
        await asyncio.sleep(0)
        assert len(log) <= number + 1
    assert not work.done()
    assert await work == "long"


async def test_short_work_shares_a_turn() -> None:
    turns, log = LoopTurns(Ticks(0), length=1), list[str]()
    works = [asyncio.ensure_future(turns.run(own(f"{n}"), steps(log, "x", 9))) for n in range(9)]
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    assert len(log) == 81
    await asyncio.gather(*works)


async def test_an_error_is_raised_where_it_is_waited_for() -> None:
    def fail() -> Generator[None, None, None]:
        yield
        raise ValueError("no")

    with pytest.raises(ValueError, match="no"):
        await of_loop().run(own("x"), fail())
    await of_loop().wait(own("x"))


async def test_what_nobody_waits_for_is_not_done() -> None:
    turns, log = LoopTurns(Ticks(), length=1), list[str]()
    given_up = asyncio.ensure_future(turns.run(own("x"), steps(log, "x", 1000)))
    await asyncio.sleep(0)
    await asyncio.sleep(0)
    given_up.cancel()
    await turns.run(own("y"), steps(log, "y"))
    await asyncio.sleep(0)
    assert log.count("x") < 5
    assert not turns._waiting


async def test_all_that_begins_at_once_has_one_turn_together() -> None:
    turns = LoopTurns(Ticks(), length=3)
    begun = [turns.first() for _ in range(3)]
    assert [expired() for expired in begun] == [False, False, True]
    await asyncio.sleep(0)
    assert not turns.first()()
    work = asyncio.ensure_future(turns.run(own("x"), steps([], "x", 50)))
    await asyncio.sleep(0)
    assert turns.first()(), "nothing begins before what waits"
    await work


async def test_the_turns_of_a_loop_are_shared() -> None:
    assert of_loop() is of_loop()


def test_a_peer_without_a_certificate_is_a_group_of_its_own() -> None:
    assert source_of("program") == TurnOwner("program", "program")
