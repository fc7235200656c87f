"""A peer that keeps the master busy: the calls of others are answered in between.

What a turn of the loop costs is counted in calls of functions, not in seconds: a machine under load
must not change the outcome. A turn lasts 5 ms, in which some ten thousand functions are called.
"""

import asyncio
import contextlib
import sys
from collections.abc import Iterator
from typing import Any

import pytest

from grants.model import Right
from tests.support.attacker import EVE
from tests.support.caller import Caller, caller
from tests.support.site import Site

LEAVES, SPACES = 204_000, 17
AT_MOST = 400_000  # functions called in one turn of the loop; one listing of all calls a million
ELEMENTS = 100
LITTLE = Right.PARAM_GET | Right.PARAM_SET | Right.GRAPH


class Work:
    """The most functions that were called between two turns of the loop, and how many turns."""

    most = turns = 0
    _calls = 0

    def _count(self, _frame: object, event: str, _argument: object) -> None:
        self._calls += event == "call"

    @contextlib.contextmanager
    def counted(self) -> Iterator[None]:
        sys.setprofile(self._count)
        try:
            yield
        finally:
            sys.setprofile(None)

    async def watch(self) -> None:
        while True:
            self._calls, before = 0, self._calls
            self.most, self.turns = max(self.most, before), self.turns + 1
            await asyncio.sleep(0)


@pytest.fixture
async def full(site: Site) -> Site:
    """A master with 204,000 parameters."""
    each = LEAVES // SPACES
    async with caller(site, "/filler", {"/**": Right.PARAM_SET}) as filler:
        for space in range(SPACES):
            tree = {f"p{number}": 1 for number in range(each)}
            assert (await filler("setParam", f"/robot/n{space}", tree))[0] == 1
    assert site.master is not None
    assert site.master.state.parameter_file is not None
    site.master.state.parameter_file.sync()  # rewrites its file, else at the next beat
    return site


QUESTIONS: list[tuple[object, ...]] = [
    ("hasParam", "/"),
    ("getParam", "/"),
    ("getParam", "/robot"),
    ("deleteParam", "/robot"),
    ("setParam", "/robot", 1),
    ("setParam", "/", {"robot": {"x": 1}}),
    ("subscribeParam", "http://127.0.0.1:9/", "/"),
    ("searchParam", "robot"),
    ("searchParam", "/robot"),
    ("getParamNames",),
]
FILTERED = {"searchParam", "getParamNames"}


@pytest.mark.attack("frozen-master")
@pytest.mark.parametrize("held", [None, "/robot/n3/p7"])
async def test_a_node_with_few_rights_does_not_block_the_master(full: Site, held: str | None) -> None:
    async with (
        caller(full, EVE, {held: LITTLE} if held else {}) as eve,
        caller(full, "/other", {"/other/**": LITTLE}) as other,
    ):
        eve.client._deadline = other.client._deadline = 120  # on a busy machine
        answering = asyncio.ensure_future(answers(other))
        for method, *params in QUESTIONS:
            work, count = Work(), 16 if method in FILTERED else ELEMENTS
            watching = asyncio.ensure_future(work.watch())
            calls = [{"methodName": method, "params": [EVE, *params]}] * count
            with work.counted():
                answer: Any = await eve.client.call("system.multicall", calls)
            watching.cancel()
            assert len(answer) == count
            assert work.most < AT_MOST, f"{work.most} functions called in one turn for {method}"
            assert not answering.done(), "a node that wants nothing but to work"
        answering.cancel()


async def answers(other: Caller) -> None:
    """The calls of others meanwhile."""
    for number in range(1_000_000):
        assert (await other("setParam", f"/other/p{number % 9}", number))[0] == 1


@pytest.mark.attack("frozen-master")
async def test_others_are_answered_during_a_long_multicall(full: Site) -> None:
    """An authorized peer gets its answers; others get theirs in between."""
    calls = [{"methodName": "getParamNames", "params": [EVE]}]
    async with caller(full, EVE, {"/robot/*/p7": LITTLE}) as eve, caller(full, "/other") as other:
        eve.client._deadline = other.client._deadline = 120  # on a busy machine
        asked = asyncio.ensure_future(eve.client.call("system.multicall", calls))
        answered = 0
        while not asked.done():
            await other("getPid")
            answered += 1
        answer: Any = await asked
        assert len(answer[0][0][2]) == SPACES
        assert answered >= 16


@pytest.mark.attack("frozen-master")
async def test_an_answer_over_the_limit_is_not_serialized(full: Site) -> None:
    """Ten megabytes that exceed the limit do not block the loop."""
    async with caller(full, EVE, {"/**": Right.PARAM_GET}) as eve:
        for method, *params in (("getParam", "/"), ("getParamNames",)):
            work = Work()
            watching = asyncio.ensure_future(work.watch())
            calls = [{"methodName": method, "params": [EVE, *params]}]
            eve.client._deadline = 120  # on a busy machine
            with work.counted():
                answer: Any = await eve.client.call("system.multicall", calls)
            watching.cancel()
            assert "ask for less at a time" in answer[0]["faultString"]
            assert work.most < AT_MOST


@pytest.mark.attack("frozen-master")
@pytest.mark.parametrize("pattern", ["/eve/**/x", "/eve/*/x"])
async def test_a_node_with_a_parameter_tree_does_not_block_the_master(site: Site, pattern: str) -> None:
    """Deep, or queried with many patterns: every leaf is covered, in many turns."""
    beside = {f"/eve/*/x{number}": LITTLE for number in range(50)}
    deep: object = {"x": 1}
    for _ in range(25 if "**" in pattern else 0):
        deep = {"a": deep}
    async with (
        caller(site, "/filler", {"/**": Right.PARAM_SET}) as filler,
        caller(site, EVE, {pattern: LITTLE, **beside}) as eve,
    ):
        eve.client._deadline = filler.client._deadline = 120  # on a busy machine
        for space in range(10):
            tree = {f"n{space}_{number}": deep for number in range(100)}
            calls = [
                {"methodName": "setParam", "params": ["/filler", f"/eve/{name}", value]}
                for name, value in tree.items()
            ]
            made: Any = await filler.client.call("system.multicall", calls)
            assert all(answer[0][0] == 1 for answer in made), made[0]
        work = Work()
        watching = asyncio.ensure_future(work.watch())
        with work.counted():
            await eve("hasParam", "/eve")
        watching.cancel()
        assert work.most < AT_MOST, f"{work.most} functions called in one turn"
