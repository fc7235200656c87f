"""The console's pages in Chromium, and what `/news` costs while many of them are open.

Everything runs on this machine: the browser takes a part of the processor that the console would
have. The pages are those of the demo's home: a robot, two who look, one of them coarsely. Open
pages are their streams alone, which a client of this process reads. `share_of_a_core` is processor
time of a process over the time that passed; `idle` is with no page open.
"""

import asyncio
import statistics
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, Final

from bench._masters import Master
from tests.support.browser import Chromium, Window, running_chromium
from tests.support.consolesite import ConsoleSite, console_site, with_robot
from tests.support.person import only_look
from tests.support.serviceprocess import children_of

PAGES: Final = ("/", "/who", "/way", "/log", "/add", "/phones")
OPEN: Final = 50
_ROUNDS: Final = 7
_SETTLED: Final = 2.0  # seconds, before anything is counted
# Of the page that is shown: the times of Navigation Timing and Paint Timing, and what it loaded.
_TIMES: Final = """(() => {
    const [page] = performance.getEntriesByType("navigation")
    const [paint] = performance.getEntriesByName("first-contentful-paint")
    const loaded = performance.getEntriesByType("resource")
        .filter(({initiatorType, name}) => !name.endsWith("/news"))
    return {
        answer: page.responseEnd, paint: paint?.startTime ?? 0, loaded: page.loadEventEnd,
        page_bytes: page.decodedBodySize, requests: 1 + loaded.length,
        bytes: page.decodedBodySize + loaded.reduce((sum, each) => sum + each.decodedBodySize, 0),
    }
})()"""


def measure(seconds: float) -> dict[str, Any]:
    """Milliseconds and bytes of each page, and processor time of the open ones."""
    with (
        tempfile.TemporaryDirectory() as root,
        console_site(Path(root) / "site") as site,
        running_chromium(Path(root)) as chromium,
    ):
        site.start_authority()
        site.start_master()
        with_robot(site)
        site.start_console()
        with chromium.window(site.origin, checked=False) as window:
            cookies = _log_in(site, window)
            pages = {path: _page(window, path) for path in PAGES}
            first = _first(chromium, site, cookies)
        return {
            "first_page_without_cache": first,
            "pages": pages,
            "share_of_a_core": {
                "idle": _shares(site, 0, cookies, seconds / 2),
                f"{OPEN} pages": _shares(site, OPEN, cookies, seconds / 2),
            },
        }


def _log_in(site: ConsoleSite, window: Window) -> dict[str, str]:
    """Log in by a code, to look; the cookies."""
    only_look(window, site)
    return window.cookies()


def _first(chromium: Chromium, site: ConsoleSite, cookies: dict[str, str]) -> dict[str, float]:
    """The first page in a browser that has nothing of the console yet."""
    rounds = []
    for _ in range(_ROUNDS):
        with chromium.window(site.origin, checked=False) as window:
            window.put_cookies(cookies)
            rounds.append(_times(window, "/"))
    return _medians(rounds)


def _page(window: Window, path: str) -> dict[str, float]:
    """A page whose styles and scripts the browser has already."""
    return _medians([_times(window, path) for _ in range(_ROUNDS)])


def _times(window: Window, path: str) -> dict[str, float]:
    window.open(path)
    window.page.wait_for_function("performance.timing.loadEventEnd > 0")
    window.page.wait_for_timeout(100)
    found: dict[str, float] = window.page.evaluate(_TIMES)
    return found


def _medians(rounds: list[dict[str, float]]) -> dict[str, float]:
    return {key: round(statistics.median(each[key] for each in rounds)) for key in rounds[0]}


def _shares(site: ConsoleSite, count: int, cookies: dict[str, str], seconds: float) -> dict[str, float]:
    """Processor time of each process over the time that passed, while `count` pages are open."""
    named = {
        "authority": [site.authority.process.pid, *children_of(site.authority.process.pid)],
        "console": [site.console.process.pid, *children_of(site.console.process.pid)],
    }
    # In a thread of its own: playwright's loop runs in this one.
    with ThreadPoolExecutor(1) as pool:
        watched = _watched(site, named, count, cookies, seconds)
        return pool.submit(asyncio.run, watched).result()


async def _watched(
    site: ConsoleSite, named: dict[str, list[int]], count: int, cookies: dict[str, str], seconds: float
) -> dict[str, float]:
    async with asyncio.TaskGroup() as group:
        streams = [group.create_task(_stream(site, cookies)) for _ in range(count)]
        await asyncio.sleep(_SETTLED)
        assert not any(stream.done() for stream in streams)
        before, begin = _used(named), time.perf_counter()
        await asyncio.sleep(seconds)
        passed, after = time.perf_counter() - begin, _used(named)
        for stream in streams:
            stream.cancel()
    return {name: round((after[name] - before[name]) / passed, 4) for name in named}


def _used(named: dict[str, list[int]]) -> dict[str, float]:
    return {name: sum(Master(pid, 0).cpu() for pid in pids) for name, pids in named.items()}


async def _stream(site: ConsoleSite, cookies: dict[str, str]) -> None:
    """Read the news as an open page does."""
    header = "; ".join(f"{name}={value}" for name, value in cookies.items())
    reader, writer = await asyncio.open_connection("127.0.0.1", site.port)
    try:
        writer.write(
            f"GET /news HTTP/1.1\r\nHost: localhost:{site.port}\r\nAccept: text/event-stream\r\n"
            f"Cookie: {header}\r\n\r\n".encode()
        )
        head = await reader.readuntil(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 200"), head
        while await reader.read(4096):
            pass
    finally:
        writer.close()
