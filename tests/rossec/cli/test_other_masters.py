"""What runs at the master's address is not this authority's: each command says what it is."""

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from tests.support.commands import Said, Shell
from tests.support.ports import free_port
from tests.support.site import Site
from tests.support.witness import until

COMMANDS = (
    ("doctor", "/robot"),
    ("topic", "list", "--as", "/robot"),
    ("topic", "pub", "/p", "std_msgs/String", "{data: x}", "--as", "/robot", "--once"),
    ("ca", "publish"),
)


async def said_by(shell: Shell, command: tuple[str, ...]) -> Said:
    run = shell.unlocked if command[0] == "ca" else shell
    return await asyncio.to_thread(run, *command)


@contextlib.asynccontextmanager
async def plain_master() -> AsyncIterator[str]:
    """As roscore answers a request for another method than its own."""

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.readuntil(b"\r\n\r\n")
        writer.write(b"HTTP/1.1 501 Unsupported method ('GET')\r\nConnection: close\r\n\r\n")
        await writer.drain()
        writer.close()

    async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
        yield f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}/"


@contextlib.asynccontextmanager
async def master_in(home: Path) -> AsyncIterator[str]:
    """`rossec master` in a home of its own."""
    port = free_port()
    uri = f"http://127.0.0.1:{port}/"
    base = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
    process = await asyncio.create_subprocess_exec(
        sys.executable,
        "-I",
        "-m",
        "rossec",
        "master",
        env={**base, "ROSSEC_HOME": str(home), "ROS_IP": "127.0.0.1", "ROS_MASTER_URI": uri},
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.DEVNULL,
    )
    try:
        await until(lambda: listens(port), within=60)
        yield uri
    finally:
        process.terminate()
        await process.wait()


def listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command[:2]))
async def test_the_master_of_another_authority_of_the_same_name(
    shell: Shell, tmp_path: Path, command: tuple[str, ...]
) -> None:
    """One left over from another try."""
    await asyncio.to_thread(shell.enroll, "/robot")
    async with Site(tmp_path / "other").running() as other:
        assert other.master is not None
        shell.environ["ROS_MASTER_URI"] = other.master.uri
        said = await said_by(shell, command)
    text = said.out + said.err
    assert said.code != 0
    assert "what runs at the master's address is of another authority: " in text
    assert "is not signed by the authority of trust domain 'home', but has its name" in text
    assert "set ROS_MASTER_URI" in text or command[0] == "ca"


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: " ".join(command[:2]))
async def test_a_plain_roscore(shell: Shell, command: tuple[str, ...]) -> None:
    await asyncio.to_thread(shell.enroll, "/robot")
    async with plain_master() as uri:
        shell.environ["ROS_MASTER_URI"] = uri
        said = await said_by(shell, command)
    text = said.out + said.err
    assert said.code != 0
    assert "is a plain master, roscore perhaps: " in text
    assert "start the other in its place: rossec master" in text or command[0] == "ca"


async def test_a_master_without_a_list_is_given_it_with_the_first_grant(shell: Shell, tmp_path: Path) -> None:
    """Authority and master in homes of their own, as they should be."""
    robot = Shell(tmp_path / "robot", shell._capsys)
    await asyncio.to_thread(shell.enroll, "/master")
    master_home = tmp_path / "master"
    (master_home / "nodes").mkdir(parents=True)
    (shell.root / "nodes" / "master").rename(master_home / "nodes" / "master")
    assert (await asyncio.to_thread(robot, "node", "request", "/robot")).code == 0
    request = robot.node("/robot") / "node.csr"
    sign = ("ca", "sign", str(request), "--yes")
    assert (await asyncio.to_thread(shell.unlocked, *sign)).code == 0
    async with master_in(master_home) as uri:
        shell.environ["ROS_MASTER_URI"] = uri
        grant = ("grant", "sign", "/robot", "--publish", "/p")
        said = await asyncio.to_thread(shell.unlocked, *grant)
        assert said.code == 0
        assert "the master has the grant" in said.out
