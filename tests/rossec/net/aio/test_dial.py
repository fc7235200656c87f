"""Several addresses of one host: the first that answers."""

import asyncio
import contextlib
import socket
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from rossec.net.aio import client as module
from rossec.net.aio.client import dial
from tests.support.ports import free_port

Found = list[tuple[Any, Any, Any, Any, tuple[str, int]]]


@pytest.fixture
def port() -> Any:
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


def resolve(monkeypatch: pytest.MonkeyPatch, *addresses: tuple[int, str, int]) -> None:
    async def getaddrinfo(*args: object, **options: object) -> Found:
        return [(family, 1, 6, "", (host, port)) for family, host, port in addresses]

    monkeypatch.setattr(asyncio.get_running_loop(), "getaddrinfo", getaddrinfo)


async def test_a_numeric_address_that_does_not_answer_at_once(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_connected", lambda _: False)
    with await dial("127.0.0.1", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)


async def test_a_numeric_address_without_a_listener() -> None:
    with pytest.raises(ConnectionRefusedError):
        await dial("127.0.0.1", free_port(), 5)
    with pytest.raises(OverflowError):
        await dial("127.0.0.1", 1 << 20, 5)


def attempts(
    monkeypatch: pytest.MonkeyPatch, port: int, **before: Callable[[], Awaitable[None]]
) -> list[socket.socket]:
    """Let `host` have the addresses first, second and so on; returns the sockets used.

    Each is connected to `port` after what `before` does.
    """
    monkeypatch.setattr(module, "STAGGER", 0.01)
    resolve(monkeypatch, *[(socket.AF_INET, name, port) for name in before])
    loop, used = asyncio.get_running_loop(), list[socket.socket]()
    sock_connect = loop.sock_connect

    async def connect(sock: socket.socket, where: tuple[str, int]) -> None:
        used.append(sock)
        await before[where[0]]()
        await sock_connect(sock, ("127.0.0.1", port))

    monkeypatch.setattr(loop, "sock_connect", connect)
    return used


async def at_once() -> None:
    """Answer without delay."""


async def never() -> None:
    """Do not answer."""
    await asyncio.sleep(60)


async def test_an_address_needs_no_resolver(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(monkeypatch)
    with await dial("127.0.0.1", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)
        assert not sock.getblocking()
    with pytest.raises(OSError, match="no address"):
        await dial("somewhere", port, 5)


async def test_a_failure_goes_on_to_the_next(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(monkeypatch, (socket.AF_INET, "127.0.0.1", free_port()), (socket.AF_INET, "127.0.0.1", port))
    with await dial("host", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)


async def test_all_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(monkeypatch, *[(socket.AF_INET, "127.0.0.1", free_port())] * 2)
    with pytest.raises(ConnectionRefusedError):
        await dial("host", 1, 5)


async def test_a_failure_while_another_is_under_way(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    failed = asyncio.Event()

    async def after_the_failure() -> None:
        await failed.wait()

    async def fail() -> None:
        failed.set()
        raise OSError("no")

    attempts(monkeypatch, port, first=after_the_failure, second=fail)
    with await dial("host", 1, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)


async def test_a_silent_address_does_not_hold_up_the_next(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    used = attempts(monkeypatch, port, first=never, second=never, third=at_once)
    with await dial("host", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)
        assert [each.fileno() == -1 for each in used] == [True, True, False]


async def test_two_that_answer_together_leave_one_socket(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    answer = asyncio.Event()

    async def together() -> None:
        await answer.wait()

    async def release() -> None:
        answer.set()

    used = attempts(monkeypatch, port, first=together, second=together, third=release)
    with await dial("host", port, 5) as sock:
        assert [each for each in used if each.fileno() != -1] == [sock]


@pytest.mark.parametrize("within", [0.05, 60])
async def test_a_dial_that_ends_early_closes_its_sockets(
    port: int, monkeypatch: pytest.MonkeyPatch, within: float
) -> None:
    begun = asyncio.Event()

    async def begin() -> None:
        begun.set()
        await never()

    used = attempts(monkeypatch, port, first=never, second=begin)
    dialling = asyncio.ensure_future(dial("host", port, within))
    await begun.wait()
    if within > 1:
        dialling.cancel()
    with pytest.raises((TimeoutError, asyncio.CancelledError)):
        await dialling
    assert dialling.cancelled() == (within > 1)
    assert [each.fileno() for each in used] == [-1, -1]


async def test_a_cancellation_while_other_attempts_end_is_kept(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    ending, ended = asyncio.Event(), asyncio.Event()

    async def slow_to_end() -> None:
        try:
            await never()
        finally:
            ending.set()
            await ended.wait()

    used = attempts(monkeypatch, port, first=slow_to_end, second=at_once)
    dialling = asyncio.ensure_future(dial("host", port, 60))
    await ending.wait()
    dialling.cancel()
    await asyncio.sleep(0)
    ended.set()
    with pytest.raises(asyncio.CancelledError):
        await dialling
    assert [each.fileno() for each in used] == [-1, -1]


async def test_a_task_that_was_cancelled_before_may_dial(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    attempts(monkeypatch, port, first=at_once, second=at_once)

    async def work() -> socket.socket:
        with contextlib.suppress(asyncio.CancelledError):
            await never()
        return await dial("host", port, 5)

    working = asyncio.ensure_future(work())
    await asyncio.sleep(0)
    working.cancel()
    with await working as sock:
        assert sock.getpeername() == ("127.0.0.1", port)
