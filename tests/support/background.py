"""A site with a master and nodes in its own thread, for commands that run their own loop."""

import asyncio
import contextlib
import threading
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import Future
from pathlib import Path

from rossec.cli.main import run
from rossec.node import Node
from tests.support.site import Site

Prepare = Callable[[Site], object]
Setup = Callable[[Node], Awaitable[None]]


@contextlib.contextmanager
def serving(root: Path, name: str, prepare: Prepare, setup: Setup) -> Iterator[Site]:
    """A site in `root` after `prepare`, its master, and the node `name` after `setup`.

    All are created in the thread, as SQLite requires; use only the site's environment.
    """
    ready: Future[Site] = Future()
    done = threading.Event()

    async def main() -> None:
        site = Site(root)
        prepare(site)
        async with site.running(), site.node(name) as node:
            await setup(node)
            ready.set_result(site)
            await asyncio.get_running_loop().run_in_executor(None, done.wait)

    def work() -> None:
        try:
            asyncio.run(main())
        except BaseException as error:  # noqa: BLE001 - told to the test
            ready.set_exception(error)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield ready.result(30)
    finally:
        done.set()
        thread.join(30)


def command(site: Site, *words: str) -> int:
    """Run one command line against the site; pytest captures its output."""
    return run(list(words), site.environ)
