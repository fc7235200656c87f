"""Many connections and disconnections leave no descriptor behind."""

import asyncio
from pathlib import Path
from typing import Final

from rossec.net.dial import dial
from rossec.ros import header
from rossec.sidecar.plain import PlainStream
from rossec.sidecar.pump import split_header
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.site import Site
from tests.support.witness import until

CYCLES: Final = 200
ASKED: Final = {"callerid": b"/ear", "topic": b"/word", "type": b"*", "md5sum": b"*"}
_AT_ONCE: Final = 20


def descriptors() -> int:
    return len(list(Path("/proc/self/fd").iterdir()))


async def test_no_descriptor_leaks(tmp_path: Path) -> None:
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

        async def once() -> None:
            stream = PlainStream(await dial("127.0.0.1", port, 10))
            await stream.send(header.encode(ASKED))
            fields, _ = await split_header(stream)
            assert "error" not in fields
            stream.abort()

        async def cycles(count: int) -> None:
            for _ in range(count // _AT_ONCE):
                async with asyncio.TaskGroup() as group:
                    for _ in range(_AT_ONCE):
                        group.create_task(once())
                for ended in robot.connections:
                    ended.abort()
                robot.connections.clear()
                robot.headers.clear()

        before = descriptors()
        await cycles(CYCLES)
        await until(lambda: descriptors() <= before + 4, within=30)
