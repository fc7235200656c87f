"""How a long-running program runs: its tasks, its end at a signal, its children, its service manager, its
log.

Tasks have an owner: they are awaited or cancelled at the end, and a crash is logged. For servers whose tasks
come and go; where a `TaskGroup` fits, use that.
"""

import asyncio
import logging
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Awaitable, Callable, Coroutine, Mapping
from contextlib import suppress
from typing import Any, Final, TypeVar

from ca.errors import HintedError
from rossec.terminal import printable, to_json

AGAIN_AFTER: Final = 2.0  # seconds until what is out of reach is tried again
READY = "READY=1"
STOPPING = "STOPPING=1"
Work = Coroutine[Any, Any, object]
_Found = TypeVar("_Found")
_log = logging.getLogger("rossec.net.tasks")


class TaskSet:
    """A set of running tasks; one that fails does not touch the others."""

    def __init__(self, on_crash: Callable[[BaseException], None] | None = None) -> None:
        self._tasks: set[asyncio.Task[Any]] = set()
        self._on_crash = on_crash

    def __len__(self) -> int:
        return len(self._tasks)

    def spawn(self, work: Coroutine[Any, Any, Any], name: str = "") -> asyncio.Task[Any]:
        task = asyncio.get_running_loop().create_task(work, name=name or None)
        self._tasks.add(task)
        task.add_done_callback(self._done)
        return task

    def _done(self, task: asyncio.Task[Any]) -> None:
        self._tasks.discard(task)
        if task.cancelled() or (error := task.exception()) is None:
            return
        _log.error("%s crashed", task.get_name(), exc_info=error)
        if self._on_crash is not None:
            self._on_crash(error)

    async def close(self) -> None:
        """Cancel what still runs and wait until it is gone."""
        # A task may close its own set: it would wait for itself.
        tasks = [task for task in self._tasks if task is not asyncio.current_task()]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


def stop_on_signals() -> asyncio.Event:
    """An event that SIGINT and SIGTERM set, in the running loop."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    return stop


async def until_first_ends(*coroutines: Work) -> None:
    """Run all until the first ends, end the others, and raise what it raised."""
    tasks = {asyncio.ensure_future(coroutine) for coroutine in coroutines}
    try:
        # Not a TaskGroup: the first to end, well or not, ends the program; nothing is an error of a group.
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        await task


async def until_stopped(stop: asyncio.Event, environ: Mapping[str, str], *parts: Work) -> None:
    """Serve: run `parts` until the first ends or `stop` is set, and tell the service manager both times."""
    notify(READY, environ)
    await until_first_ends(*parts, stop.wait())
    notify(STOPPING, environ)


async def until_reached(
    attempt: Callable[[], Awaitable[_Found]],
    stop: asyncio.Event,
    missing: type[HintedError] | tuple[type[HintedError], ...],
    tell: Callable[[HintedError], None],
) -> _Found | None:
    """What `attempt` finds at last; None if `stop` is set before. `tell` is told each new reason why not yet.

    A service that is started with its host must not end because the host of its peer starts later.
    """
    told = ""
    while not stop.is_set():
        try:
            return await attempt()
        except missing as error:
            # The same reason every two seconds would fill the log.
            if told != str(error):
                tell(error)
            told = str(error)
        with suppress(TimeoutError):
            async with asyncio.timeout(AGAIN_AFTER):
                await stop.wait()
    return None


async def reap(process: "subprocess.Popen[bytes]", within: float) -> None:
    """Wait until `process` has ended; kill it after `within` seconds, or when this is cancelled."""
    try:
        await asyncio.to_thread(process.wait, within)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    except asyncio.CancelledError:
        process.kill()
        process.wait()
        raise


def notify(state: str, environ: Mapping[str, str] = os.environ) -> bool:
    """Send `state` to $NOTIFY_SOCKET (sd_notify(3)); returns whether it was sent, a failure is ignored."""
    address = environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    # A service manager that does not listen is no reason to end what serves.
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.connect(f"\0{address[1:]}" if address.startswith("@") else address)
        sock.sendall(state.encode())
        return True
    return False


class JsonFormatter(logging.Formatter):
    def format(self, record: logging.LogRecord) -> str:
        entry: dict[str, Any] = {
            "at": round(record.created, 3),
            "level": record.levelname.lower(),
            "logger": record.name,
            "text": printable(record.getMessage()),
        }
        if record.exc_info:
            entry["traceback"] = self.formatException(record.exc_info)
        return to_json(entry)


def log_as_json() -> None:
    """Log to stderr as JSON, instead of whatever was set up."""
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(JsonFormatter())
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
