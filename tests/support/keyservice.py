"""The authority's service in a thread of this process: its audit is a list."""

import asyncio
import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.process import AuditedCaller, KeyServiceProcess, admit_all, operations_of
from rossec.host.local_sockets import UnixPeer


@dataclass
class RunningService:
    """What runs: its operations, and the lines of its audit."""

    operations: KeyOperations
    audit: list[str] = field(default_factory=list)


@contextlib.contextmanager
def running_service(
    home: AuthorityHome,
    admit: Callable[[UnixPeer], None] = admit_all,
    join_port: Callable[[], int] = int,
    phone_code: Callable[[AuditedCaller], str] | None = None,
) -> Iterator[RunningService]:
    """The service of the authority in `home`, locked."""
    lines: list[str] = []
    running = RunningService(operations_of(home, lines.append, join_port), lines)
    process = KeyServiceProcess(home, running.operations, admit, phone_code)
    started, ended = threading.Event(), asyncio.Event()
    loop = asyncio.new_event_loop()

    async def main() -> None:
        await process.start()
        started.set()
        await ended.wait()
        # In Python 3.11 a connection is not closed that comes while its server is (gh-109564).
        await asyncio.sleep(0.05)
        await process.close()

    thread = threading.Thread(target=lambda: loop.run_until_complete(main()))
    thread.start()
    try:
        assert started.wait(10)
        yield running
    finally:
        loop.call_soon_threadsafe(ended.set)
        thread.join(10)
        loop.run_until_complete(loop.shutdown_default_executor())
        loop.close()
