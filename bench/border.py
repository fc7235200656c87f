"""A border router of constrained things: sizes, times and memory, with processes of their own.

`edhoc_bytes` are the three messages of EDHOC with kids of one octet, without CoAP. The first
request is handshake and registration together. `observe_latency_ms` is from the notification of a
thing to the message at a subscriber. Memory is what 1,000 things that are registered, observed and
at rest add to the router's process (PSS, its own master is another process).
"""

import asyncio
import contextlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Any, Final

from aiocoap.numbers import codes

from ca.encoding import encode
from rossec.border.handshakes import StaticKey
from rossec.master.operation import raise_descriptor_limit
from rossec.saved_statements import ThingFiles
from tests.support.border import LAMP, BorderSite
from tests.support.rawthing import RawThing
from tests.support.site import Site

THINGS: Final = 1000
TRIES: Final = 60
PAUSE: Final = 0.045  # seconds: of one host the router looks at 25 handshakes a second
AT_REST: Final = 12.0  # seconds from the last registration to the measurement
_LINKS: Final = b'</t>;rt="ros.pub";if="std_msgs/Float64";title="~t";ct=60'


def _pss(process: int) -> float:
    """Proportional memory in MB."""
    text = Path(f"/proc/{process}/smaps_rollup").read_text()
    (line,) = (line for line in text.splitlines() if line.startswith("Pss:"))
    return int(line.split()[1]) / 1024


def _body(value: float) -> bytes:
    return encode({"data": value})


def _run_master(root: Path, ready: Any, stop: Any) -> None:
    """The master of the site at `root`; the authority is in the parent's process."""
    from rossec.home import NodeHome  # noqa: PLC0415 - in the process that uses it
    from rossec.master.server import master_of  # noqa: PLC0415 - as above

    async def serve() -> None:
        raise_descriptor_limit()
        home = NodeHome.of(root, "/master")
        master = master_of(
            home, host="127.0.0.1", port=0, newest=home.load_revocations(), now=int(time.time())
        )
        await master.start()
        ready.put(master.uri)
        while not stop.is_set():  # noqa: ASYNC110 - of another process
            await asyncio.sleep(0.2)
        await master.close()

    asyncio.run(serve())


@contextlib.contextmanager
def _router(site: Site, uri: str) -> Iterator[tuple[int, tuple[str, int]]]:
    environ = {**os.environ, **site.environ, "ROS_MASTER_URI": uri}
    command = [sys.executable, "-m", "rossec", "border", "--listen", "::1", "--port", "0", "--json"]
    with subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True) as router:
        assert router.stdout is not None
        host, port = json.loads(router.stdout.readline())["ready"]
        try:
            yield router.pid, (host, port)
        finally:
            router.send_signal(signal.SIGTERM)
            router.wait(60)


async def _latencies(thing: RawThing, site: Site, uri: str) -> list[float]:
    site.variables["ROS_MASTER_URI"] = uri
    site.subscribe("/heating", f"{LAMP}/t")
    found: list[float] = []
    async with site.node("/heating") as node:
        seen = await node.subscriber(f"{LAMP}/t", "std_msgs/Float64")
        while not seen.links:  # noqa: ASYNC110 - a state without an event
            await asyncio.sleep(0.02)
        arrived = aiter(seen)
        for number in range(TRIES):
            await asyncio.sleep(0.15)  # within the rate of a thing
            value, began = float(number + 1), time.perf_counter()
            thing.notify(_body(value))
            async with asyncio.timeout(5):
                while (await anext(arrived)).data != value:
                    pass
            found.append(time.perf_counter() - began)
    return found


async def _times(border: BorderSite, where: tuple[str, int], uri: str) -> dict[str, float]:
    peer = border.key.credential
    first, later = [], []
    thing = RawThing(where, peer, _LINKS, state=_body(0.0))
    border.state(LAMP, thing.credential)
    border.allow()
    await thing.start()
    for _ in range(TRIES // 4):
        began = time.perf_counter()
        assert await thing.register()
        first.append(time.perf_counter() - began)
        await asyncio.sleep(0.2)
    for _ in range(TRIES):
        began = time.perf_counter()
        await thing.request(codes.GET, ("nothing",))
        later.append(time.perf_counter() - began)
        await asyncio.sleep(0.12)
    seen = await _latencies(thing, border.site, uri)
    thing.close()
    return {
        "edhoc_bytes": sum(thing.sizes.values()),
        "first_request_ms": round(median(first) * 1000, 1),
        "request_ms": round(median(later) * 1000, 1),
        "observe_latency_ms": round(median(seen) * 1000, 1),
    }


async def _many(border: BorderSite, where: tuple[str, int], router: int, many: int) -> float:
    """MB that so many things add, registered, observed, and at rest."""
    things = []
    for number in range(many):
        name, kid = f"/things/t{number}", (number + 256).to_bytes(2)
        thing = RawThing(where, border.key.credential, _LINKS, kid, _body(float(number)))
        border.state(name, thing.credential)
        border.allow(name)
        things.append(thing)
    before = _pss(router)
    for thing in things:
        await asyncio.sleep(PAUSE)
        await thing.start()
        assert await thing.register()
        while not thing._observers:  # noqa: SLF001, ASYNC110 - its own, a state without an event
            await asyncio.sleep(0.02)
    await asyncio.sleep(AT_REST)
    added = _pss(router) - before
    for thing in things:
        thing.close()
    return round(added, 1)


def measure(seconds: float = 20.0, *, things: int = THINGS) -> dict[str, Any]:
    """The figures; `seconds` is not used: the number of things decides."""
    del seconds
    raise_descriptor_limit()
    with tempfile.TemporaryDirectory() as folder:
        site = Site(Path(folder) / "site")
        master = site.enroll("/master")
        newest = site.authority.store.newest_list()
        assert newest is not None
        master.save_revocations(newest)
        border = BorderSite(site)
        border.key = StaticKey(ThingFiles(border.home).router_key())
        context = multiprocessing.get_context("spawn")
        ready, stop = context.Queue(), context.Event()
        process = context.Process(target=_run_master, args=(site.root, ready, stop))
        process.start()
        try:
            uri = ready.get(timeout=60)
            with _router(site, uri) as (router, where):
                found: dict[str, Any] = asyncio.run(_times(border, where, uri))
                added = asyncio.run(_many(border, where, router, things))
                return {**found, f"things_{things}_rss_added_mb": added}
        finally:
            stop.set()
            process.join(30)
