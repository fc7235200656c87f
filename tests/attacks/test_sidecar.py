"""Attacks on a sidecar: from the network, from another user of the host, from a program inside.

Those on calls and headers are tested in `tests/rossec/sidecar/core`; here are the ones that
need real sockets and real users.
"""

import asyncio
import contextlib
import os
import socket
import subprocess
from collections.abc import AsyncIterator, Collection
from pathlib import Path
from typing import Any

import pytest

from grants.model import Restriction, Right
from rossec.channel.opening import WireProtocol
from rossec.errors import RossecError
from rossec.net.aio import connect
from rossec.net.aio.client import dial
from rossec.net.limits import HalfOpenLimits
from rossec.net.rpc.calls import RpcClient
from rossec.sidecar import executor
from rossec.sidecar.core.layers import local_endpoint
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import until

NOBODY = 65534
PRIVATE = (b"robot", b"word", b"std_msgs", b"home", b"callerid", b"md5sum")
PROBES = (
    b"",
    b"\0" * 64,
    b"GET / HTTP/1.0\r\n\r\n",
    b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
    b"\x40\0\0\0\x10\0\0\0callerid=/nobody\x0b\0\0\0topic=/word",
    b"POST / HTTP/1.1\r\nContent-Length: 100\r\n\r\n<methodCall><methodName>getPid",
)
CALL = """
import sys, socket, xmlrpc.client
socket.setdefaulttimeout(10)
try:
    print("ANSWERED", xmlrpc.client.ServerProxy(sys.argv[1]).getSystemState("/robot"))
except Exception as error:
    print("REFUSED", type(error).__name__)
"""


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    site = Site(tmp_path / "site")
    site.publish("/robot", "/word")
    site.grant("/robot", Right.GRAPH, "/**")
    async with site.running() as site:
        yield site


@pytest.fixture
async def near(site: Site) -> AsyncIterator[Sidecar]:
    async with sidecar(site) as near:
        yield near


@pytest.fixture
async def robot(near: Sidecar) -> AsyncIterator[Program]:
    async with Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        yield robot


async def call_as(uri: str, user: int | None) -> str:
    process = await asyncio.create_subprocess_exec(
        "/usr/bin/python3",
        "-c",
        CALL,
        uri,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        user=user,
        env={"PATH": "/usr/bin"},
    )
    said, _ = await process.communicate()
    return said.decode()


@pytest.mark.attack("borrowed-identity")
async def test_the_process_of_another_user_cannot_borrow_the_identity(near: Sidecar, robot: Program) -> None:
    if os.getuid() != 0:
        pytest.skip("NOT RUN: only root can start a process of another user")
    agent = near._agent_for("/robot")
    public_uri = (
        f"http://127.0.0.1:{next(iter(agent._egress.ports)).port}/" if any(agent._egress.ports) else ""
    )
    assert (await call_as(near.uri, None)).startswith("ANSWERED")
    for uri in filter(None, (near.uri, public_uri)):
        assert (await call_as(uri, NOBODY)).startswith("REFUSED")


def listening() -> set[int]:
    """The TCP ports this process listens on."""
    inodes = set()
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):
            inodes.add(str(entry.readlink()).removeprefix("socket:[").removesuffix("]"))
    ports = set()
    for table in ("/proc/net/tcp", "/proc/net/tcp6"):
        for line in Path(table).read_text().splitlines()[1:]:
            fields = line.split()
            if fields[3] == "0A" and fields[9] in inodes:
                ports.add(int(fields[1].rpartition(":")[2], 16))
    return ports


def probed(port: int, probe: bytes) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=5) as sock:
        sock.settimeout(1.0)
        answer = b""
        try:
            sock.sendall(probe)
            while part := sock.recv(4096):
                answer += part
        except OSError:
            pass
        return answer


@pytest.mark.attack("scanned-sidecar")
async def test_a_scan_of_open_ports_learns_nothing(site: Site, near: Sidecar) -> None:
    """L8: ports on the network answer only with the refusal for plain peers."""
    before = listening()
    async with Program("/robot", near) as robot:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        opened = listening() - before - {robot.slave.port, robot.topics.port}
        assert opened
        for port in opened:
            answers = await asyncio.gather(*(asyncio.to_thread(probed, port, probe) for probe in PROBES))
            for answer in answers:
                assert not any(word in answer for word in PRIVATE), answer
        assert robot.calls == []


@pytest.mark.attack("program-port")
async def test_another_process_on_a_programs_port_is_refused(
    site: Site, near: Sidecar, robot: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The program ends between the check of the listener and the connection."""
    thieves: list[socket.socket] = []
    port = robot.slave.port

    async def taken_meanwhile(*place: Any) -> socket.socket:
        if place[1] == port and robot.slave._is_open:
            await robot.slave.close()
            thieves.append(socket.create_server(("127.0.0.1", port)))
        return await dial(*place)

    site.subscribe("/ear", "/word")
    async with sidecar(site) as far, Program("/ear", far) as ear:
        uris = await ear.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(uris, list)
        monkeypatch.setattr(executor, "dial", taken_meanwhile)
        with pytest.raises(RossecError):
            await ear.ask(uris[0], "requestTopic", "/word", [["TCPROS"]])
    with thieves[0] as thief:
        thief.settimeout(10)
        sock, _ = thief.accept()
        with sock:
            assert sock.recv(100) == b"", "it hears nothing"


def silent_connections(ports: Collection[int], times: int, stack: contextlib.ExitStack) -> None:
    """Open as many silent connections as possible."""
    for port in ports:
        for _ in range(times):
            with contextlib.suppress(OSError):
                stack.enter_context(socket.create_connection(("127.0.0.1", port), timeout=5))


@pytest.mark.attack("sidecar-exhausted")
async def test_half_open_connections_are_limited_across_ports(near: Sidecar, robot: Program) -> None:
    """N8: ten ports would use more descriptors than a process has, and programs need some."""
    agent = near._agent_for("/robot")
    for port in range(1, 4):
        agent.open_ingress(local_endpoint(WireProtocol.TCPROS, port))
    servers = tuple(agent._ingress.ports)
    cap = HalfOpenLimits().per_address
    with contextlib.ExitStack() as stack:
        ports = [server.port for server in servers]
        await asyncio.to_thread(silent_connections, ports, cap // 2, stack)
        await until(lambda: sum(server.connections for server in servers) == cap)
        assert len(servers) * (cap // 2) > cap
        assert await robot.ask(near.uri, "getPid") is not None


@pytest.mark.attack("steered-program")
async def test_the_slave_api_is_closed_to_peers(site: Site, near: Sidecar, robot: Program) -> None:
    """N1-N4 and L1 through a sidecar: the program gets no such call."""
    home = site.enroll("/mallory")
    agent = near._agent_for("/robot")
    port = next(iter(agent._ingress.ports)).port
    stream = await connect(
        "127.0.0.1", port, unlimited(home.credentials(), site.anchor.verify), WireProtocol.HTTP
    )
    client = RpcClient(stream)
    for method, params in (
        ("shutdown", ("/mallory", "x")),
        ("shutdown", ("/master", "x")),
        ("publisherUpdate", ("/master", "/word", ["http://evil:1/"])),
        ("paramUpdate", ("/master", "/k", 1)),
        ("getPid", ("/mallory",)),
        ("getBusInfo", ("/mallory",)),
        ("launch", ("<launch/>",)),
        ("rossec.revocationUpdate", ("/master", b"", b"")),
        ("system.multicall", ([],)),
    ):
        answer = await client.call(method, *params)
        assert isinstance(answer, list)
        assert answer[0] == -1, (method, answer)
    await client.close()
    assert robot.calls == []


@pytest.mark.attack("confused-deputy")
async def test_a_program_has_only_the_rights_of_its_agent(site: Site, near: Sidecar) -> None:
    """L7: a call through a sidecar has the rights of its program alone."""
    site.enroll("/weak")
    async with Program("/weak", near) as weak:
        for method, params in (
            ("registerPublisher", ("/word", "std_msgs/String", weak.uri)),
            ("getParam", ("/secret",)),
            ("shutdown", ("now",)),
        ):
            answer = await weak.ask(weak.master_uri, method, *params)
            assert isinstance(answer, list)
            assert answer[0] == -1, (method, answer)
            assert "/weak" in answer[1]
    answer = await weak.ask(near.uri, "getSystemState")
    assert isinstance(answer, list)
    assert answer[2] == [[], [], []]


@pytest.mark.attack("crashed-check")
async def test_a_failing_check_closes_the_connection(
    site: Site, near: Sidecar, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A crash ends the connection; nothing is forwarded."""

    def crash(*_: object) -> object:
        raise RuntimeError("a bug")

    site.subscribe("/ear", "/word", Restriction(rate=1))
    async with sidecar(site) as far, Program("/robot", near) as robot, Program("/ear", far) as ear:
        await robot.register("registerPublisher", "/word", "std_msgs/String")
        uris = await ear.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(uris, list)
        monkeypatch.setattr("rossec.participant.definitions.guard_for", crash)
        with pytest.raises(Exception, match=r"closed|reset"):
            await ear.subscribe(uris[0], "/word")
