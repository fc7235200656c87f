"""Connections that never end, with a few bytes each: how many descriptors they can use.

The attacker is a process of its own; what is counted are the descriptors of the one attacked.
"""

import asyncio
import contextlib
import socket
import sys
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Final

import pytest

from rossec.channel.opening import WireProtocol
from rossec.enrollment.enroll import WaitingNode
from rossec.errors import ChannelError
from rossec.net.aio import connect
from rossec.net.limits import HalfOpenLimits
from rossec.net.threads.secure_socket import SecureSocket
from rossec.participant import connections
from rossec.ros.names import parse_uri
from rossec.sidecar.core.layers import local_endpoint
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import HOST, credentials
from tests.support.contexts import unlimited
from tests.support.enrolling import Robot
from tests.support.pki import NOW
from tests.support.site import Site
from tests.support.victim import attacked, slave_port
from tests.support.witness import until

CONNECTIONS: Final = 600
CAP: Final = HalfOpenLimits().per_address
OTHERS: Final = 60  # descriptors that come and go for other reasons
FLOOD: Final = """
import resource, socket, sys
host, port, count, data, *sources = sys.argv[1:]
resource.setrlimit(resource.RLIMIT_NOFILE, (4096, 4096))
held = []
for number in range(int(count)):
    source = (sources[number % len(sources)], 0) if sources else None
    sock = socket.create_connection((host, int(port)), 30, source)
    try:
        sock.sendall(bytes.fromhex(data))
    except OSError:
        pass
    held.append(sock)
print("ALL", flush=True)
sys.stdin.read()
"""


@contextlib.asynccontextmanager
async def flood(port: int, data: bytes, *sources: str, count: int = CONNECTIONS) -> AsyncIterator[None]:
    """Open connections; each sends `data` and stays open."""
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-c",
        FLOOD,
        HOST,
        str(port),
        str(count),
        data.hex(),
        *sources,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
    )
    try:
        assert process.stdout is not None
        assert await process.stdout.readline() == b"ALL\n"
        yield
    finally:
        process.kill()
        await process.communicate()


def descriptors(pid: int | None = None) -> int:
    return sum(1 for _ in Path(f"/proc/{pid or 'self'}/fd").iterdir())


@contextlib.asynccontextmanager
async def watched(pid: int | None = None) -> AsyncIterator[list[int]]:
    """The most descriptors that were in use, above those before."""
    before, most = descriptors(pid), [0]

    async def look() -> None:
        while True:
            most[0] = max(most[0], descriptors(pid) - before)
            await asyncio.sleep(0 if pid is None else 0.01)

    looking = asyncio.create_task(look())  # noqa: TID251 - cancelled below
    try:
        yield most
    finally:
        looking.cancel()


async def served(site: Site, port: int, protocol: WireProtocol) -> None:
    """An honest caller is authenticated at its first attempt."""
    stream = await connect(
        HOST, port, unlimited(site.enroll("/honest").credentials(), site.anchor.verify), protocol
    )
    stream.abort("done")


@contextlib.asynccontextmanager
async def node_topics(site: Site) -> AsyncIterator[tuple[int, WireProtocol]]:
    async with site.node("/robot") as robot:
        yield robot.topic_endpoint()[1], WireProtocol.TCPROS


@contextlib.asynccontextmanager
async def node_api(site: Site) -> AsyncIterator[tuple[int, WireProtocol]]:
    async with site.node("/robot") as robot:
        yield parse_uri(robot.uri)[1], WireProtocol.HTTP


@contextlib.asynccontextmanager
async def master(site: Site) -> AsyncIterator[tuple[int, WireProtocol]]:
    assert site.master is not None
    yield site.master.port, WireProtocol.HTTP


@contextlib.asynccontextmanager
async def sidecar_port(site: Site) -> AsyncIterator[tuple[int, WireProtocol]]:
    site.publish("/robot", "/word")
    async with sidecar(site) as near, Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        agent = near._agent_for("/robot")
        yield (
            agent.open_ingress(local_endpoint(WireProtocol.TCPROS, robot.topics.port)),
            WireProtocol.TCPROS,
        )


Place = Callable[[Site], contextlib.AbstractAsyncContextManager[tuple[int, WireProtocol]]]
PLACES: Final = [node_topics, node_api, master, sidecar_port]


@pytest.mark.attack("descriptors")
@pytest.mark.parametrize("place", PLACES)
async def test_failed_handshakes_do_not_exhaust_descriptors(site: Site, place: Place) -> None:
    """Four bytes end the handshake; the socket counts until the refusal is sent."""
    async with place(site) as (port, protocol), watched() as most:
        async with flood(port, b"\xff\xff\xff\xff"):
            await served(site, port, protocol)
        assert most[0] <= CAP + OTHERS


@pytest.mark.attack("descriptors")
@pytest.mark.parametrize("place", PLACES)
async def test_silent_connections_from_many_addresses_are_limited(site: Site, place: Place) -> None:
    """Together they use every slot; a new address gets one of them."""
    sources = [f"127.0.0.{number}" for number in range(2, 8)]
    async with place(site) as (port, protocol), watched() as most:
        async with flood(port, b"\x0c\0\0", *sources):
            await served(site, port, protocol)
        assert most[0] <= HalfOpenLimits().total + OTHERS


@pytest.mark.attack("descriptors")
async def test_an_enrolled_caller_that_never_closes_is_limited(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is refused after it was authenticated; its open socket still counts as its own."""
    monkeypatch.setattr(connections, "PEER_CONNECTIONS", 8)
    own, held = unlimited(credentials(site), site.anchor.verify), []
    async with site.node("/robot") as robot, watched() as most:
        for _ in range(40):
            dialled = socket.create_connection((HOST, robot.topic_endpoint()[1]))
            held.append(await asyncio.to_thread(SecureSocket.initiate, dialled, own, timeout=30))
            with contextlib.suppress(ChannelError):
                held[-1].sendall(b"no header of a connection")
        assert most[0] - len(held) <= 8 + 8
        for sock in held:
            sock.close()


@pytest.mark.ros
@pytest.mark.attack("descriptors")
async def test_a_rospy_node(tmp_path: Path) -> None:
    async with attacked(tmp_path) as victim:
        pid = victim.program.process.pid
        for port in (victim.port, slave_port(victim)):
            async with watched(pid) as most:
                async with flood(port, b"\xff\xff\xff\xff"):
                    await victim.goes_on()
                assert most[0] <= CAP + OTHERS
        await served(victim.site, victim.port, WireProtocol.TCPROS)


@pytest.mark.attack("descriptors")
async def test_a_node_that_waits_to_be_enrolled() -> None:
    refused: list[str] = []
    core = Robot().enrollment()
    async with WaitingNode(core, lambda: NOW, refused.append) as waiting, watched() as most:
        await waiting.listen(HOST, 0)
        async with flood(waiting.port, b"\xff\xff\xff\xff"):
            await until(lambda: refused)
            await until(lambda: len(waiting) == 0)
        assert most[0] <= 2 * 128 + OTHERS  # asyncio accepts all that the kernel has queued
