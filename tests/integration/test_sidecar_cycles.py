"""Many connections and disconnections leave nothing behind: no descriptor, no memory.

Ten thousand connections of programs, each with a call that the sidecar answers over its connection
to the master. As many with a handshake between two sidecars would take minutes for the
signatures alone; of those there are as many as time permits.
"""

import asyncio
import gc
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Final

from rossec.net.aio.client import dial
from rossec.ros import tcpros
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.pump import split_header
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.site import Site
from tests.support.witness import until

PROGRAMS: Final = 10_000
SECURED: Final = 400
GROWTH: Final = 6.0  # MB, after the first tenth: the allocator's reserve varies
ASKED: Final = {"callerid": b"/ear", "topic": b"/word", "type": b"*", "md5sum": b"*"}
_AT_ONCE: Final = 20


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


def resident() -> float:
    """In MB."""
    gc.collect()
    status = Path("/proc/self/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


async def cycles(count: int, once: Callable[[], Awaitable[None]], after: Callable[[], None]) -> None:
    for _ in range(count // _AT_ONCE):
        async with asyncio.TaskGroup() as group:
            for _ in range(_AT_ONCE):
                group.create_task(as_task(once))
        after()


async def as_task(once: Callable[[], Awaitable[None]]) -> None:
    await once()


async def stays_flat(count: int, once: Callable[[], Awaitable[None]], after: Callable[[], None]) -> None:
    await cycles(count // 10, once, after)
    open_before, before = descriptors(), resident()
    await cycles(count - count // 10, once, after)
    await until(lambda: descriptors() <= open_before + 4, within=30)
    assert resident() < before + GROWTH


async def test_ended_programs_leave_nothing_in_the_sidecar(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.publish("/robot", "/word")
    site.subscribe("/ear", "/word")
    async with (
        site.running(),
        sidecar(site) as near,
        sidecar(site) as far,
        Program("/robot", near) as robot,
        Program("/ear", far) as ear,
    ):
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        uris = await ear.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(uris, list)
        answer = await ear.ask(uris[0], "requestTopic", "/word", [["TCPROS"]])
        assert isinstance(answer, list)
        port = answer[2][2]

        async def secured() -> None:
            stream = PlainStream(await dial("127.0.0.1", port, 10))
            await stream.send(tcpros.encode(ASKED))
            fields, _ = await split_header(stream)
            assert "error" not in fields
            stream.abort()

        async def asks() -> None:
            answer = await ear.ask(ear.master_uri, "getPid")
            assert isinstance(answer, list)
            assert answer[0] == 1

        def robot_hangs_up() -> None:
            for ended in robot.connections:
                ended.abort()
            robot.connections.clear()
            robot.headers.clear()

        await stays_flat(SECURED, secured, robot_hangs_up)
        await stays_flat(PROGRAMS, asks, robot_hangs_up)
