"""The service's wait for identities to renew, with a master that is played."""

import asyncio
import contextlib
import hashlib
from collections.abc import AsyncIterator, Callable
from types import SimpleNamespace
from typing import Any, cast

import pytest

from ca.encoding import Value
from rossec.authority.keyservice import network as module
from rossec.authority.keyservice.network import RenewalWatch
from rossec.authority.keyservice.process import FrontEndProcess
from rossec.authority.keyservice.work import AuthorityWork
from rossec.errors import KeyServiceRefused
from rossec.ros.names import SETTLE_RENEWALS, WATCH_RENEWALS
from tests.support.witness import until


class PlayedMaster:
    """Offers what is in `waiting` once, or what `answer` returns."""

    def __init__(self) -> None:
        self.waiting = list[bytes]()
        self.calls = list[tuple[str, Value]]()
        self.error: Exception | None = None
        self.answer: Callable[[], Value] | None = None

    async def call(self, method: str, arguments: list[Value], within: int) -> Value:
        await asyncio.sleep(0.005)
        self.calls.append((method, arguments[0]))
        if self.error is not None:
            raise self.error
        if method == SETTLE_RENEWALS:
            return 1
        if self.answer is not None:
            return self.answer()
        items: list[Value] = [*self.waiting]
        if arguments[0] == 1:
            return {"renewals": [], "waiting": len(items)}
        self.waiting.clear()
        return {"renewals": items, "waiting": len(items)}

    def settled(self) -> list[Any]:
        found: list[Any] = [value for method, value in self.calls if method == SETTLE_RENEWALS]
        return [each for answers in found for each in answers]


class Playing:
    def __init__(self) -> None:
        self.master = PlayedMaster()
        self.key = SimpleNamespace(is_locked=False)
        self.is_ready = True
        self.watch = RenewalWatch(
            cast("FrontEndProcess", self.master), cast("AuthorityWork", self.key), self.renew
        )

    async def renew(self, requests: list[bytes]) -> list[tuple[bytes, bytes, str]]:
        found = [(hashlib.sha256(data).digest(), b"new " + data, "") for data in requests]
        return found if self.is_ready else []


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("FIRST_PAUSE", "LONGEST_PAUSE"):
        monkeypatch.setattr(module, name, 0.02)


@contextlib.asynccontextmanager
async def running() -> AsyncIterator[Playing]:
    playing = Playing()
    task = asyncio.ensure_future(playing.watch.run())
    try:
        yield playing
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def test_what_nodes_ask_for_is_answered() -> None:
    async with running() as playing:
        playing.master.waiting += [b"one", b"two"]
        await until(lambda: len(playing.master.settled()) == 2)
        digest = hashlib.sha256(b"one").digest()
        assert playing.master.settled()[0] == [digest, b"new one", ""]


async def test_a_locked_service_says_so_and_looks_again_when_it_is_unlocked(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with running() as playing:
        playing.key.is_locked = True
        playing.master.waiting.append(b"one")
        await until(lambda: (WATCH_RENEWALS, 1) in playing.master.calls)
        await until(lambda: "1 node waits for a new identity" in caplog.text)
        assert "rossec ca unlock --for 8h" in caplog.text
        assert playing.master.settled() == []
        playing.key.is_locked = False
        playing.watch.wake()
        await until(playing.master.settled)


async def test_what_cannot_be_signed_in_this_moment_is_left_for_later() -> None:
    async with running() as playing:
        playing.is_ready = False
        playing.master.waiting.append(b"one")
        await until(lambda: not playing.master.waiting)
        count = len(playing.master.calls)
        await until(lambda: len(playing.master.calls) > count + 2)
        assert playing.master.settled() == []


async def test_a_crash_is_logged_and_ends_nothing(
    caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else nobody's identity would be renewed until the service is started again."""
    monkeypatch.setattr(module, "QUIET", 0.0)
    async with running() as playing:
        playing.master.error = ZeroDivisionError("a bug")
        await until(lambda: "a bug" in caplog.text)
        playing.master.error = OSError(24, "Too many open files")
        await until(lambda: "Too many open files" in caplog.text)
        playing.master.error = None
        playing.master.waiting = [b"a"]
        await until(lambda: bool(playing.master.settled()))


@pytest.mark.parametrize(
    "error", [KeyServiceRefused('method "rossec.watchRenewals" is not supported'), TimeoutError()]
)
async def test_a_master_that_does_not_answer_is_said_once_and_asked_again(
    error: Exception, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "QUIET", 0.0)
    async with running() as playing:
        playing.master.error = error
        await until(lambda: len(playing.master.calls) > 4)
        said = [line for line in caplog.messages if "no identities are renewed" in line]
        assert len(said) == 1
        playing.master.error = None
        playing.master.waiting.append(b"one")
        await until(playing.master.settled)


async def test_a_master_that_starts_after_the_service_is_waited_for_without_a_warning(
    caplog: pytest.LogCaptureFixture,
) -> None:
    async with running() as playing:
        playing.master.error = TimeoutError()
        await until(lambda: len(playing.master.calls) > 4)
        playing.master.error = None
        playing.master.waiting.append(b"one")
        await until(playing.master.settled)
    assert caplog.messages == []


@pytest.mark.parametrize("answer", [1, {}, {"renewals": b"x", "waiting": 1}])
async def test_an_odd_answer_has_nothing_to_do(answer: Value) -> None:
    async with running() as playing:
        playing.master.answer = lambda: answer
        await until(lambda: len(playing.master.calls) > 4)
        assert playing.master.settled() == []
