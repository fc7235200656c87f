"""Who may use a sidecar's loopback ports: the user, and the program it was started for."""

import asyncio
import os
import socket
import subprocess
import sys

import pytest

from rossec.errors import PeerUserRefused
from rossec.net.host import peeruid
from rossec.sidecar.callers import Callers
from tests.rossec.sidecar.child_programs import programs

CONNECT = "import socket,sys; s=socket.create_connection(('127.0.0.1',int(sys.argv[1]))); s.recv(1)"


def connecting(port: int) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", CONNECT, str(port)])


async def test_a_child_may_and_a_stranger_may_not() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        connecting(server.getsockname()[1]) as child,
    ):
        near, _ = server.accept()
        with near:
            await Callers({os.getuid()}).check(near)
            ours = Callers({os.getuid()}, os.getpid())
            await ours.check(near)
            await ours.check(near)  # known by now
            with (
                socket.create_connection(server.getsockname()),
                server.accept()[0] as own,
                pytest.raises(PeerUserRefused, match="belongs to another program"),
            ):
                await ours.check(own)  # who is known does not vouch for others
            with pytest.raises(PeerUserRefused, match="belongs to another program"):
                await Callers({os.getuid()}, child.pid).check(near)
            with pytest.raises(PeerUserRefused, match="may not use this sidecar"):
                await Callers({os.getuid() + 1}, os.getpid()).check(near)
            with pytest.raises(PeerUserRefused):
                await Callers(set()).check(near)


async def test_who_listens_is_checked_before_it_is_reached() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        await Callers({os.getuid()}).check_listener(port)
        with pytest.raises(PeerUserRefused):
            await Callers({os.getuid() + 1}).check_listener(port)
        with pytest.raises(PeerUserRefused):
            await Callers({os.getuid()}, os.getpid()).check_listener(
                port
            )  # we are not our own child
    with pytest.raises(ConnectionRefusedError):
        await Callers({os.getuid()}).check_listener(port)


async def test_a_listener_beside_the_program_is_nobodys_business() -> None:
    """Anybody may bind the same port of another loopback address, or only to be in the way."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_server(("127.0.0.2", port)) as other:
            callers = Callers({os.getuid()})
            (holder,) = await callers.check_listener(port)
            assert holder.inode == os.fstat(server.fileno()).st_ino
            callers.check_unchanged(port, [holder])
            assert holder.inode != os.fstat(other.fileno()).st_ino
        server.close()
        with (
            socket.create_server(("127.0.0.1", port)),
            pytest.raises(ConnectionRefusedError, match="another program listens"),
        ):
            callers.check_unchanged(port, [holder])


async def test_users_of_another_user_namespace_are_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    """They all show as the same one, even if that is the user it serves."""
    monkeypatch.setattr(peeruid, "is_known", lambda user: user != os.getuid())
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        pytest.raises(PeerUserRefused),
    ):
        await Callers({os.getuid()}).check_listener(server.getsockname()[1])


async def test_many_programs_are_told_apart_together(monkeypatch: pytest.MonkeyPatch) -> None:
    """A search for each connection grows with the programs twice: a hundred got nowhere."""
    looks: list[None] = []
    readlink = os.readlink

    def counted(path: str) -> str:
        looks.append(None)
        return readlink(path)

    monkeypatch.setattr(os, "readlink", counted)
    count, files, each = 20, 40, 4
    with programs(count, files) as many:
        ends = [many.connection(which) for which in range(count) for _ in range(each)]
        callers = Callers({os.getuid()}, os.getpid())
        await asyncio.gather(*map(callers.check, ends))
        assert len(looks) < 5 * count * (files + each)
        for end in ends:
            end.close()
