"""The kernel is asked for one socket; its answers are read strictly."""

import os
import socket
import struct
from typing import Self

import pytest

from rossec.host import local_sockets


def message(kind: int, body: bytes) -> bytes:
    return struct.pack("=IHHII", 16 + len(body), kind, 0, 1, 0) + body


@pytest.mark.parametrize("client", ["127.0.0.1", "::ffff:127.0.0.1", "::1"])
def test_one_connection(client: str) -> None:
    host = "::1" if client == "::1" else "127.0.0.1"
    family = socket.AF_INET6 if ":" in client else socket.AF_INET
    server_family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.create_server((host, 0), family=server_family) as server, socket.socket(family) as remote:
        remote.connect((client, server.getsockname()[1]))
        local, _ = server.accept()
        with local:
            ends = local.getpeername()[:2], local.getsockname()[:2]
            found = local_sockets.find(*ends)
            assert found is not None
            assert (found.user, found.inode) == (os.getuid(), os.fstat(remote.fileno()).st_ino)
            assert local_sockets.find((ends[0][0], 1), ends[1]) is None
            assert local_sockets.find(ends[1], (ends[0][0], 1)) is None  # not the listener
        remote.close()
        found = local_sockets.find(*ends)
        assert found is None or found.inode == 0


def two_at_one_port() -> tuple[socket.socket, socket.socket]:
    """Listeners at 127.0.0.1 and 127.0.0.2; others take ports at the same time."""
    while True:
        server = socket.create_server(("127.0.0.1", 0))
        try:
            return server, socket.create_server(("127.0.0.2", server.getsockname()[1]))
        except OSError:
            server.close()


def test_the_listener_that_would_be_reached() -> None:
    server, other = two_at_one_port()
    with server:
        port = server.getsockname()[1]
        with other:
            for host, listens in (("127.0.0.1", server), ("127.0.0.2", other)):
                found = local_sockets.listener((host, port))
                assert found is not None
                assert (found.user, found.inode) == (os.getuid(), os.fstat(listens.fileno()).st_ino)
        assert local_sockets.listener(("127.0.0.2", port)) is None
        with socket.create_connection(("127.0.0.1", port)):
            assert local_sockets.listener(("127.0.0.1", port)) is not None
    assert local_sockets.listener(("127.0.0.1", port)) is None


@pytest.mark.parametrize("host", ["0.0.0.0", "::"])
def test_a_listener_at_every_address(host: str) -> None:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    dual = family == socket.AF_INET6
    with socket.create_server((host, 0), family=family, dualstack_ipv6=dual) as server:
        found = local_sockets.listener(("127.0.0.1", server.getsockname()[1]))
        assert found is not None
        assert found.inode == os.fstat(server.fileno()).st_ino


@pytest.mark.parametrize(
    "data",
    [
        b"short",
        struct.pack("=IHHII", 4000, 20, 0, 1, 0),
        struct.pack("=IHHII", 3, 20, 0, 1, 0),
        message(20, b"too short"),
        message(99, bytes(72)),
        message(2, b""),
        message(2, struct.pack("=i", -95)),
    ],
)
def test_an_invalid_answer_is_refused(data: bytes) -> None:
    with pytest.raises(OSError, match=r"answer|not supported"):
        local_sockets.parse(data)


ROW = local_sockets.SocketEntry(1, (b"\x7f\0\0\1", 5000), (b"\x7f\0\0\1", 6000), 1000, 4711)


@pytest.mark.parametrize(
    "other",
    [
        ROW._replace(state=10),
        ROW._replace(state=6),
        ROW._replace(local=(b"\x7f\0\0\1", 5001)),
        ROW._replace(remote=(b"\x7f\0\0\2", 6000)),
    ],
)
def test_only_the_very_connection_counts(
    monkeypatch: pytest.MonkeyPatch, other: local_sockets.SocketEntry
) -> None:
    ends = ("127.0.0.1", 5000), ("127.0.0.1", 6000)
    monkeypatch.setattr(local_sockets, "_ask", lambda _: ROW)
    assert local_sockets.find(*ends) == ROW
    assert local_sockets.listener(ends[0]) is None, "it is no listener"
    monkeypatch.setattr(local_sockets, "_ask", lambda _: other)
    assert local_sockets.find(*ends) is None


class Stranger:
    """A netlink socket on which another process answers."""

    def __init__(self, *_: object) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def send(self, _: bytes) -> None: ...

    def recvfrom(self, _: int) -> tuple[bytes, tuple[int, int]]:
        return message(20, bytes(72)), (4711, 0)


def test_an_answer_of_another_process_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(socket, "socket", Stranger)
    with pytest.raises(OSError, match="an answer from another process"):
        local_sockets.find(("127.0.0.1", 5000), ("127.0.0.1", 6000))
