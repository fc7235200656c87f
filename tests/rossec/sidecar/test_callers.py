"""Who may use a sidecar's loopback ports: the user, and the program it was started for."""

import os
import socket
import subprocess
import sys

import pytest

from rossec.errors import PeerUserRefused
from rossec.sidecar.callers import Callers, descendants, held_by, parents

CONNECT = "import socket,sys; s=socket.create_connection(('127.0.0.1',int(sys.argv[1]))); s.recv(1)"


def test_descendants() -> None:
    family = [(2, 1), (3, 2), (4, 3), (5, 1), (6, 9)]
    assert sorted(descendants(family, 2)) == [3, 4]
    assert sorted(descendants(family, 1)) == [2, 3, 4, 5]
    assert descendants(family, 4) == []


def test_the_kernel_names_parents() -> None:
    assert (os.getpid(), os.getppid()) in set(parents())


def test_a_child_may_and_a_stranger_may_not() -> None:
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        subprocess.Popen([sys.executable, "-c", CONNECT, str(server.getsockname()[1])]) as child,
    ):
        near, _ = server.accept()
        with near:
            Callers({os.getuid()}).check(near)
            Callers({os.getuid()}, os.getpid()).check(near)
            with pytest.raises(PeerUserRefused, match="belongs to another program"):
                Callers({os.getuid()}, child.pid).check(near)
            with pytest.raises(PeerUserRefused, match="may not use this sidecar"):
                Callers({os.getuid() + 1}, os.getpid()).check(near)
            with pytest.raises(PeerUserRefused):
                Callers(set()).check(near)


def test_who_listens_is_checked_before_it_is_reached() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        Callers({os.getuid()}).check_listener(port)
        with pytest.raises(PeerUserRefused):
            Callers({os.getuid() + 1}).check_listener(port)
        with pytest.raises(PeerUserRefused):
            Callers({os.getuid()}, os.getpid()).check_listener(port)  # we are not our own child
    with pytest.raises(ConnectionRefusedError):
        Callers({os.getuid()}).check_listener(port)


def test_processes_that_are_gone_hold_nothing() -> None:
    assert not held_by(1, [0, 1 << 30])
