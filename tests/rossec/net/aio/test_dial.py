"""Several addresses of one host: the first that answers."""

import asyncio
import contextlib
import socket
from typing import Any

import pytest

from rossec.net.aio import dial as module
from rossec.net.aio.dial import dial

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
        await dial("127.0.0.1", closed_port(), 5)
    with pytest.raises(OverflowError):
        await dial("127.0.0.1", 1 << 20, 5)


async def test_a_failure_while_another_is_under_way(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_STAGGER", 0.01)
    resolve(monkeypatch, *[(socket.AF_INET, "127.0.0.1", n) for n in (1, 2)])
    real, failed = module._attempt, asyncio.Event()

    async def attempt(family: int, where: tuple[str, int]) -> socket.socket:
        if where[1] == 2:
            failed.set()
            raise OSError("no")
        await failed.wait()
        return await real(family, ("127.0.0.1", port))

    monkeypatch.setattr(module, "_attempt", attempt)
    with await dial("host", 1, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)


async def the_others() -> None:
    """Wait for every task but this one."""
    me = asyncio.current_task()
    await asyncio.gather(*asyncio.all_tasks() - {me}, return_exceptions=True)


def closed_port() -> int:
    with socket.socket() as sock:
        sock.bind(("127.0.0.1", 0))
        found: int = sock.getsockname()[1]
        return found


async def test_an_address_needs_no_resolver(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(monkeypatch)
    with await dial("127.0.0.1", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)
        assert not sock.getblocking()
    with pytest.raises(OSError, match="no address"):
        await dial("somewhere", port, 5)


async def test_a_failure_goes_on_to_the_next(port: int, monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(
        monkeypatch,
        (socket.AF_INET, "127.0.0.1", closed_port()),
        (socket.AF_INET, "127.0.0.1", port),
    )
    with await dial("host", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)


async def test_all_fail(monkeypatch: pytest.MonkeyPatch) -> None:
    resolve(monkeypatch, *[(socket.AF_INET, "127.0.0.1", closed_port())] * 2)
    with pytest.raises(ConnectionRefusedError):
        await dial("host", 1, 5)


async def test_a_silent_address_does_not_hold_up_the_next(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "_STAGGER", 0.01)
    resolve(monkeypatch, *[(socket.AF_INET, "127.0.0.1", n) for n in (1, 2, 3)])
    real, ended = module._attempt, []

    async def attempt(family: int, where: tuple[str, int]) -> socket.socket:
        if where[1] == 1:
            try:
                await asyncio.sleep(60)
            finally:
                ended.append(1)
        if where[1] == 2:
            try:
                await asyncio.sleep(60)
            except asyncio.CancelledError:
                return await real(family, ("127.0.0.1", port))  # too late to be wanted
        return await real(family, ("127.0.0.1", port))

    monkeypatch.setattr(module, "_attempt", attempt)
    with await dial("host", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)
    await the_others()
    assert ended == [1]


async def test_the_connected_address_does_not_wait_for_the_others(
    port: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A caller cancelled while it waits for the other attempts would leak its socket."""
    resolve(monkeypatch, *[(socket.AF_INET, "127.0.0.1", n) for n in (1, 2)])
    monkeypatch.setattr(module, "_STAGGER", 0.01)
    real, late, stubborn = module._attempt, [], asyncio.Event()

    async def attempt(family: int, where: tuple[str, int]) -> socket.socket:
        sock = await real(family, ("127.0.0.1", port))
        while where[1] == 1 and not stubborn.is_set():
            late.append(sock)
            with contextlib.suppress(asyncio.CancelledError):
                await stubborn.wait()
        return sock

    monkeypatch.setattr(module, "_attempt", attempt)
    with await dial("host", port, 5) as sock:
        assert sock.getpeername() == ("127.0.0.1", port)
    stubborn.set()
    await the_others()
    assert [sock.fileno() for sock in late] == [-1]
