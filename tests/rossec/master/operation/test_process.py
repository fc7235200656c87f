"""A master's process: one in a directory, until a signal or a task ends it."""

import asyncio
import os
import resource
import signal
import socket
from pathlib import Path

import pytest

from rossec.errors import ConfigurationError
from rossec.master.operation.process import (
    READY,
    notify,
    process_lock,
    raise_descriptor_limit,
    stop_on_signals,
    until_first_ends,
)


def test_a_second_master_is_refused_until_the_first_ends(tmp_path: Path) -> None:
    with process_lock(tmp_path):
        second = process_lock(tmp_path)
        with pytest.raises(ConfigurationError, match="another master runs from") as caught, second:
            pytest.fail("two masters run from one directory")
        assert "end it first" in (caught.value.hint or "")
    with process_lock(tmp_path):
        pass


@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        ((1024, 1 << 20), (65536, 1 << 20)),
        ((1024, 4096), (4096, 4096)),
        ((1024, resource.RLIM_INFINITY), (65536, resource.RLIM_INFINITY)),
        ((1 << 17, 1 << 20), None),
        ((resource.RLIM_INFINITY, resource.RLIM_INFINITY), None),
    ],
)
def test_the_soft_limit_is_raised_as_far_as_the_hard_one_allows(
    monkeypatch: pytest.MonkeyPatch,
    limits: tuple[int, int],
    expected: tuple[int, int] | None,
) -> None:
    changes: list[tuple[int, int]] = []
    monkeypatch.setattr(resource, "getrlimit", lambda _: limits)
    monkeypatch.setattr(resource, "setrlimit", lambda _, limit: changes.append(limit))
    raise_descriptor_limit()
    assert changes == ([] if expected is None else [expected])


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
async def test_a_signal_sets_the_event(number: signal.Signals) -> None:
    stop = stop_on_signals()
    try:
        assert not stop.is_set()
        os.kill(os.getpid(), number)
        async with asyncio.timeout(10):
            await stop.wait()
    finally:
        for each in (signal.SIGINT, signal.SIGTERM):
            asyncio.get_running_loop().remove_signal_handler(each)


async def test_the_first_task_that_ends_cancels_the_others() -> None:
    cancelled = asyncio.Event()

    async def endless() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            cancelled.set()

    async with asyncio.timeout(10):
        await until_first_ends(endless(), asyncio.sleep(0.01))
        await cancelled.wait()


async def test_what_the_first_task_raises_is_raised() -> None:
    async def failing() -> None:
        raise OSError("the address is gone")

    with pytest.raises(OSError, match="gone"):
        await until_first_ends(failing(), asyncio.Event().wait())


@pytest.mark.parametrize("abstract", [False, True])
def test_the_manager_is_notified(tmp_path: Path, abstract: bool) -> None:
    name = str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(f"\0{name}" if abstract else name)
        assert notify(READY, {"NOTIFY_SOCKET": f"@{name}" if abstract else name})
        assert manager.recv(100) == b"READY=1"


@pytest.mark.parametrize("address", [None, "", "relative", "/nowhere/at/all"])
def test_a_manager_that_does_not_listen_is_ignored(address: str | None) -> None:
    assert not notify(READY, {} if address is None else {"NOTIFY_SOCKET": address})
