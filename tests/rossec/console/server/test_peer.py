"""Whose connection it is, on localhost."""

import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from rossec.console.server.serving import check_peer
from rossec.errors import PeerUserRefused
from rossec.host import local_sockets

OWN = frozenset({os.geteuid()})


def scope_of(connected: socket.socket) -> dict[str, object]:
    """As uvicorn describes the server's end of a connection."""
    return {"client": connected.getsockname(), "server": connected.getpeername()}


@contextmanager
def connection() -> Iterator[socket.socket]:
    """A client that is connected to a server of this host, which has accepted it."""
    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        socket.create_connection(server.getsockname()) as client,
        server.accept()[0],
    ):
        yield client


def test_a_program_of_this_user_may() -> None:
    with connection() as client:
        check_peer(scope_of(client), OWN)


def test_one_of_another_user_may_not() -> None:
    with connection() as client, pytest.raises(PeerUserRefused, match="another user"):
        check_peer(scope_of(client), frozenset({os.geteuid() + 1}))


def test_a_socket_that_nobody_holds_any_more_is_nobodys() -> None:
    with connection() as client:
        gone = scope_of(client)
        client.close()
        with pytest.raises(PeerUserRefused):
            check_peer(gone, OWN | {0})


@pytest.mark.parametrize("scope", [{}, {"client": None, "server": ("127.0.0.1", 1)}])
def test_a_connection_without_addresses_is_nobodys(scope: dict[str, object]) -> None:
    with pytest.raises(PeerUserRefused, match="nobody knows"):
        check_peer(scope, OWN)


def test_a_kernel_that_does_not_say_is_a_refusal(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise OSError

    monkeypatch.setattr(local_sockets, "find_holder", fail)
    with pytest.raises(PeerUserRefused, match="nobody knows"):
        check_peer({"client": ("127.0.0.1", 1), "server": ("127.0.0.1", 2)}, OWN)


def test_a_user_of_another_namespace_is_unknown(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(local_sockets, "is_known", lambda user: False)
    with connection() as client, pytest.raises(PeerUserRefused):
        check_peer(scope_of(client), OWN)


def test_a_console_that_is_not_on_localhost_asks_for_sessions_alone() -> None:
    check_peer({}, None)
