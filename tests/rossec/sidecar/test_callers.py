"""Access to a sidecar's loopback ports: by user, and by the program it was started for."""

import asyncio
import os
import socket
import subprocess
import sys

import pytest

from rossec.errors import PeerUserRefused
from rossec.host import local_sockets
from rossec.host.callers import Callers
from tests.rossec.sidecar.child_programs import programs

CONNECT = "import socket,sys; s=socket.create_connection(('127.0.0.1',int(sys.argv[1]))); s.recv(1)"


def connecting(port: int) -> "subprocess.Popen[bytes]":
    return subprocess.Popen([sys.executable, "-c", CONNECT, str(port)])


async def test_a_child_is_allowed_and_other_processes_are_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server, connecting(server.getsockname()[1]) as child:
        accepted, _ = server.accept()
        with accepted:
            await Callers({os.getuid()}).check(accepted)
            callers = Callers({os.getuid()}, os.getpid())
            await callers.check(accepted)
            await callers.check(accepted)  # cached by now
            with (
                socket.create_connection(server.getsockname()),
                server.accept()[0] as own,
                pytest.raises(PeerUserRefused, match="belongs to another program"),
            ):
                await callers.check(own)  # the cache does not allow others
            with pytest.raises(PeerUserRefused, match="belongs to another program"):
                await Callers({os.getuid()}, child.pid).check(accepted)
            with pytest.raises(PeerUserRefused, match="may not use this sidecar"):
                await Callers({os.getuid() + 1}, os.getpid()).check(accepted)
            with pytest.raises(PeerUserRefused):
                await Callers(set()).check(accepted)


async def test_a_listener_is_checked_before_connecting() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        await Callers({os.getuid()}).check_listener(port)
        with pytest.raises(PeerUserRefused):
            await Callers({os.getuid() + 1}).check_listener(port)
        with pytest.raises(PeerUserRefused):
            await Callers({os.getuid()}, os.getpid()).check_listener(
                port
            )  # this process is not its own child
    with pytest.raises(ConnectionRefusedError):
        await Callers({os.getuid()}).check_listener(port)


async def test_only_the_listener_of_the_same_address_is_checked() -> None:
    """Any user can bind the same port at another loopback address."""
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


async def test_users_of_another_user_namespace_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """They all appear as one user, even if that is the allowed one."""
    monkeypatch.setattr(local_sockets, "is_known", lambda user: user != os.getuid())
    with socket.create_server(("127.0.0.1", 0)) as server, pytest.raises(PeerUserRefused):
        await Callers({os.getuid()}).check_listener(server.getsockname()[1])


async def test_many_programs_are_checked_with_few_searches(monkeypatch: pytest.MonkeyPatch) -> None:
    """One search per connection would be quadratic: a hundred programs timed out."""
    reads: list[None] = []
    readlink = os.readlink

    def counted(path: str) -> str:
        reads.append(None)
        return readlink(path)

    monkeypatch.setattr(os, "readlink", counted)
    count, files, each = 20, 40, 4
    with programs(count, files) as several:
        ends = [several.connection(which) for which in range(count) for _ in range(each)]
        callers = Callers({os.getuid()}, os.getpid())
        await asyncio.gather(*map(callers.check, ends))
        assert len(reads) < 5 * count * (files + each)
        for end in ends:
            end.close()
