"""The secure connections of one process: both roles, limits, and itself."""

import socket
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest

from rossec.channel.opening import WireProtocol
from rossec.errors import ChannelError, IdentityRefused
from rossec.inprocess.identity import Connector, LocalIdentity
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from rossec.participant.connections import OwnAddresses
from tests.support.secure_sockets import background
from tests.support.site import Site


@pytest.fixture
def robot(tmp_path: Path) -> LocalIdentity:
    """A node with room for one half-open connection."""
    robot = LocalIdentity(Site(tmp_path / "site").enroll("/robot"), "/robot")
    robot.live_context = replace(robot.live_context, half_open=HalfOpenCount(HalfOpenLimits(total=1)))
    return robot


def test_a_caller_that_is_gone_is_not_counted(robot: LocalIdentity) -> None:
    """Else a peer that disconnects often enough locks all others out."""
    connector = Connector(robot)
    for _ in range(3):
        gone = socket.socket()
        assert connector.admit(gone, "127.0.0.1")
        gone.close()
        with pytest.raises(OSError, match="descriptor"):
            connector.respond(gone, WireProtocol.TCPROS)


def answer(listener: socket.socket, connector: Connector) -> None:
    """Serve one caller until it closes."""
    sock, (host, _) = listener.accept()
    assert connector.admit(sock, host)
    with socket.socket() as other:
        assert not connector.admit(other, host)
    with connector.respond(sock, WireProtocol.TCPROS) as stream:
        stream.recv(1)
        with socket.socket() as other:
            assert connector.admit(other, host)


def test_a_node_reaches_itself_at_its_own_address(robot: LocalIdentity) -> None:
    own_addresses = OwnAddresses()
    connector = Connector(robot, own_addresses)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        host, port = listener.getsockname()
        own_addresses.add_ports(host, port)
        thread = background(partial(answer, listener, connector))
        sock = socket.create_connection((host, port))
        with connector.initiate(sock, WireProtocol.TCPROS, (host, port)) as stream:
            assert stream.peer is not None
            assert stream.peer.name == "/robot"
            assert stream.gettimeout() is None
        thread.join(30)


def test_a_node_does_not_reach_itself_at_another_address(robot: LocalIdentity) -> None:
    connector = Connector(robot)
    with socket.create_server(("127.0.0.1", 0)) as listener:
        thread = background(partial(refuse, listener, connector))
        sock = socket.create_connection(listener.getsockname())
        with pytest.raises(IdentityRefused):
            connector.initiate(sock, WireProtocol.TCPROS, listener.getsockname())
        assert sock.fileno() == -1
        thread.join(30)


def refuse(listener: socket.socket, connector: Connector) -> None:
    """Serve one caller that ends the handshake."""
    with connector.respond(listener.accept()[0], WireProtocol.TCPROS) as stream, pytest.raises(ChannelError):
        stream.do_handshake()
