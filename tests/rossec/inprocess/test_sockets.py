"""The socket that rospy gets, with both ends in this process."""

import contextlib
import errno
import socket
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import pytest

from rossec.errors import ChannelClosed, LimitExceeded
from rossec.inprocess import identity, sockets
from rossec.inprocess.identity import Connector, LocalIdentity
from rossec.inprocess.options import PlainPeers
from rossec.inprocess.sockets import RosSocket
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from rossec.ros.tcpros import FrameReader, Framing
from tests.rossec.inprocess.socket_pair import connected, owner
from tests.support.secure_sockets import background
from tests.support.site import Site


def test_a_socket_connects_sends_and_receives(local_identity: LocalIdentity, listening: RosSocket) -> None:
    left, right = connected(local_identity, listening)
    assert (left.peer.name, right.peer.name, left.is_plain) == ("/viewer", "/robot", False)
    assert left.fileno() > 0
    left.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    assert left.getsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE) == 1
    assert left.getpeername() == right.getsockname()
    assert left.send(b"hello") == 5
    buffer = bytearray(5)
    assert right.recv_into(buffer) == 5
    right.sendall(bytes(buffer))
    assert left.recv(10) == b"hello"
    assert not left.try_send(b"x") or left.try_send(b"y")
    left.setblocking(False)
    assert left.gettimeout() == 0.0
    with pytest.raises(BlockingIOError):
        left.recv(1)
    assert not left.unsent
    right.shutdown()
    left.abort()
    with pytest.raises(ConnectionResetError, match="rossec: "):
        left.sendall(b"x")
    for sock in (left, right):
        sock.close()
        assert sock.fileno() == -1
        sock.abort()


def test_a_socket_of_ipv6_reaches_a_forwarded_port_at_127_0_0_1(
    local_identity: LocalIdentity, listening: RosSocket
) -> None:
    """As those of rospy are with ROS_IPV6=on."""
    left, right = connected(local_identity, listening, socket.AF_INET6)
    assert left.peer.name == "/viewer"
    for sock in (left, right):
        sock.close()


def test_a_message_that_has_begun_must_make_progress(
    local_identity: LocalIdentity, listening: RosSocket, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sockets, "PATIENCE", 0.05)
    monkeypatch.setattr("rossec.peer_limits.WINDOW", 1)
    left, right = connected(local_identity, listening)
    framing = Framing(FrameReader())
    right.sendall(b"\x09\0\0\0half")
    assert framing.feed(left.receive_before_deadline(framing, lambda: left.recv(100)), 0) == []
    right.sendall(b", and")
    assert framing.feed(left.receive_before_deadline(framing, lambda: left.recv(100)), 0) == [b"half, and"]
    right.sendall(b"\x09\0\0\0half")
    framing.feed(left.receive_before_deadline(framing, lambda: left.recv(100)), 0)
    with pytest.raises(LimitExceeded):
        left.receive_before_deadline(framing, lambda: left.recv(100))
    assert left.gettimeout() is None
    left.settimeout(0.01)
    with pytest.raises(TimeoutError):  # a timeout that is set already is kept
        left.receive_before_deadline(framing, lambda: left.recv(100))
    for sock in (left, right):
        sock.close()


def test_nothing_is_sent_directly_before_the_channel_was_read(
    local_identity: LocalIdentity, listening: RosSocket
) -> None:
    left, right = connected(local_identity, listening)
    assert not left.try_send(b"first"), "nothing was read from the channel yet"
    left.sendall(b"first")
    assert left.try_send(b"second")
    assert right.recv(10) + right.recv(10) == b"firstsecond"
    for sock in (left, right):
        sock.close()


def test_a_socket_that_is_not_connected_raises(local_identity: LocalIdentity) -> None:
    sock = RosSocket(owner(local_identity), socket.socket())
    with pytest.raises(ChannelClosed, match="not connected"):
        _ = sock.stream
    sock.settimeout(1.0)
    assert sock.gettimeout() == 1.0
    assert not sock.unsent
    assert not sock.try_send(b"x")
    sock.shutdown()
    sock.close()


def test_a_caller_over_the_limit_is_dropped(site: Site) -> None:
    robot = LocalIdentity(site.enroll("/robot"), "/robot")
    robot.live_context = replace(robot.live_context, half_open=HalfOpenCount(HalfOpenLimits(total=1)))
    sock = RosSocket(owner(robot), socket.socket())
    sock.bind(("127.0.0.1", 0))
    sock.listen()
    first = socket.create_connection(sock.getsockname())
    accepted, _ = sock.accept()
    with pytest.raises(ChannelClosed, match="not authenticated"):
        _ = accepted.peer
    second = socket.create_connection(sock.getsockname())
    later: list[RosSocket] = []
    thread = background(lambda: later.append(sock.accept()[0]))
    second.settimeout(10)
    assert second.recv(1) == b""
    accepted.close()
    third = socket.create_connection(sock.getsockname())
    thread.join(30)
    for caller in (first, second, third):
        caller.close()
    for ours in (sock, *later):
        ours.close()
    assert len(later) == 1


def test_a_host_without_descriptors_pauses_accepting(
    local_identity: LocalIdentity, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sockets, "ACCEPT_PAUSE", 0.0)
    answers: list[Any] = [OSError(errno.EMFILE, "too many"), OSError(errno.EBADF, "closed")]

    def accept() -> None:
        raise answers.pop(0)

    sock = RosSocket(owner(local_identity), SimpleNamespace(accept=accept))  # type: ignore[arg-type]
    with pytest.raises(OSError, match="closed"):
        sock.accept()
    assert answers == []


@pytest.fixture
def stock() -> Iterator[tuple[str, int]]:
    """A plain ROS node, as its callers see it."""
    server = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with contextlib.suppress(OSError):  # how the shutdown below appears
            while True:
                answer(server.accept()[0])

    def answer(caller: socket.socket) -> None:
        with caller, contextlib.suppress(ConnectionError):
            if caller.recv(1, socket.MSG_PEEK) == b"s":
                caller.sendall(b"plain")
            else:
                caller.sendall(b"\4\0\0\0nope")
            caller.recv(100)

    thread = background(serve)
    yield server.getsockname()
    server.shutdown(socket.SHUT_RDWR)  # wakes the accept; a close alone would not
    server.close()
    thread.join(30)


def test_a_plain_peer_is_refused(local_identity: LocalIdentity, stock: tuple[str, int]) -> None:
    sock = RosSocket(owner(local_identity), socket.socket())
    with pytest.raises(ConnectionError, match="plain"):
        sock.connect(stock)
    sock.close()


def test_a_plain_peer_that_is_allowed(local_identity: LocalIdentity, stock: tuple[str, int]) -> None:
    sock = RosSocket(owner(local_identity, PlainPeers(["/x"])), socket.socket())
    sock.connect(stock)
    assert sock.is_plain
    with pytest.raises(ChannelClosed, match="not authenticated"):
        sock.handshake()
    assert not sock.try_send(b"s")
    assert not sock.unsent
    sock.sendall(b"s")
    assert sock.recv(10) == b"plain"
    sock.settimeout(5)
    assert sock.gettimeout() == 5
    sock.shutdown()
    sock.close()


def test_the_first_bytes_of_a_plain_caller_are_not_consumed(local_identity: LocalIdentity) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        for sent, seen in (
            (b"POST / HTTP/1.1\r\n", b"POST"),
            (b"\x06\0\0\0\x02\0\0\0a=", b"\x06\0\0\0\x02\0\0\0a="),
            (b"\xff\xff\xff\xff\xff", b""),
        ):
            caller = socket.create_connection(server.getsockname())
            sock, _ = server.accept()
            caller.sendall(sent)
            caller.shutdown(socket.SHUT_WR)
            assert identity.peek(sock) == seen
            caller.close()
            sock.close()
    assert identity.plain_fields(b"\x06\0\0\0\x02\0\0\0a=") == {"a": b""}
    assert identity.plain_fields(b"abc") == {}
    assert identity.plain_fields(b"\x01\0\0\0a") == {}


def test_a_caller_that_is_gone_does_not_end_accept(
    local_identity: LocalIdentity, monkeypatch: pytest.MonkeyPatch
) -> None:
    sock = RosSocket(owner(local_identity), socket.socket())
    sock.bind(("127.0.0.1", 0))
    sock.listen()
    respond, first = Connector.respond, [OSError("gone")]

    def fail_once(connector: Connector, caller: socket.socket, *more: Any) -> Any:
        if first:
            caller.close()
            raise first.pop()
        return respond(connector, caller, *more)

    monkeypatch.setattr(Connector, "respond", fail_once)
    callers = [socket.create_connection(sock.getsockname()) for _ in range(2)]
    accepted, where = sock.accept()
    assert where == callers[1].getsockname()
    for caller in callers:
        caller.close()
    for ours in (accepted, sock):
        ours.close()


def test_peek_does_not_wait_for_a_silent_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(identity, "DEADLINE", 0.05)
    with socket.create_server(("127.0.0.1", 0)) as server:
        for sent in (b"", b"PO", b"\x06\0\0\0\x02\0"):
            with socket.create_connection(server.getsockname()) as caller:
                sock, _ = server.accept()
                caller.sendall(sent)
                assert identity.peek(sock) in (b"", sent)
                assert sock.gettimeout() is None
                sock.close()


def test_an_aborted_socket_receives_nothing_more(local_identity: LocalIdentity, listening: RosSocket) -> None:
    left, right = connected(local_identity, listening)
    right.sendall(b"before")
    left.abort()
    assert left.aborted
    assert left.recv(10) == b""
    left.run_timers()
    for sock in (left, right):
        sock.close()


def test_a_refused_channel_is_an_error_for_rospy(
    site: Site, local_identity: LocalIdentity, listening: RosSocket
) -> None:
    def hang_up() -> None:
        sock, _ = listening.accept()
        sock.close()

    for closed_locally in (False, True):
        thread = background(hang_up)
        sock = RosSocket(owner(local_identity), socket.socket())
        sock.closed_locally = closed_locally
        expected = "closed" if closed_locally else "True "
        with pytest.raises(ConnectionError, match=expected):
            sock.connect(listening.getsockname())
        thread.join(30)
        sock.close()


def test_a_named_caller_stays_plain(local_identity: LocalIdentity) -> None:
    listening = RosSocket(owner(local_identity, PlainPeers(["/x"])), socket.socket())
    listening.bind(("127.0.0.1", 0))
    listening.listen()
    with socket.create_connection(listening.getsockname()) as caller:
        caller.sendall(b"\x06\0\0\0\x02\0\0\0a=")
        sock, _ = listening.accept()
        assert sock.peek() == b"\x06\0\0\0\x02\0\0\0a="
        sock.switch_to_plain()
        sock.switch_to_plain()  # once is enough
        assert sock.is_plain
        sock.raise_unit_limit(5)  # there are no units
        sock.run_timers()
        assert sock.recv(100) == b"\x06\0\0\0\x02\0\0\0a="
        sock.sendall(b"hello")
        assert caller.recv(10) == b"hello"
        sock.abort()
        assert caller.recv(10) == b""
        sock.close()
    listening.close()
