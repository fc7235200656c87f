"""The process that a master runs in: alone in its directory, with enough descriptors, to its end.

It ends at a signal, or when one of its tasks does. The service manager is notified with the
datagrams of sd_notify(3), without its library.
"""

import asyncio
import os
import resource
import signal
import socket
from collections.abc import Coroutine, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from rossec import files
from rossec.errors import ConfigurationError

LOCK_NAME: Final = "master.lock"
DESCRIPTORS: Final = 65536  # each node takes two, and a shell's soft limit is often 1024
READY: Final = "READY=1"
STOPPING: Final = "STOPPING=1"


@contextmanager
def process_lock(directory: Path) -> Iterator[None]:
    """Hold the lock of the master in `directory`, which ends with the process.

    Raises:
        ConfigurationError: another master holds it.
    """
    busy = ConfigurationError(
        f"another master runs from {directory}",
        "end it first; two would lose each other's parameters",
    )
    descriptor = files.lock_file(directory / LOCK_NAME, busy)
    try:
        yield
    finally:
        os.close(descriptor)


def raise_descriptor_limit() -> None:
    """Raise the soft limit to `DESCRIPTORS`, or to the hard limit where that is lower."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    missing = DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < missing:
        resource.setrlimit(resource.RLIMIT_NOFILE, (missing, hard))


def stop_on_signals() -> asyncio.Event:
    """An event that SIGINT and SIGTERM set, in the running loop."""
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    return stop


async def until_first_ends(*coroutines: Coroutine[Any, Any, object]) -> None:
    """Run all until the first ends, cancel the others, and raise what it raised."""
    tasks = {asyncio.ensure_future(coroutine) for coroutine in coroutines}
    done, running = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in running:
        task.cancel()
    for task in done:
        await task


def notify(state: str, environ: Mapping[str, str] = os.environ) -> bool:
    """Send `state` to $NOTIFY_SOCKET; returns whether it was sent.

    A failure to send is ignored.
    """
    address = environ.get("NOTIFY_SOCKET", "")
    if not address.startswith(("/", "@")):
        return False
    with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sock:
        sock.connect(f"\0{address[1:]}" if address.startswith("@") else address)
        sock.sendall(state.encode())
        return True
    return False
