"""What a socket lets through: units of a bounded size, and calls that pass a filter."""

import contextlib
from typing import Any

from rossec.errors import ChannelError
from rossec.inprocess.identity import LocalIdentity
from rossec.inprocess.sockets import RosSocket
from rossec.ros.tcpros import FrameReader, Framing
from tests.rossec.inprocess.socket_pair import connected
from tests.support.secure_sockets import background


def test_an_authorized_peer_may_send_larger_units(
    local_identity: LocalIdentity, listening: RosSocket
) -> None:
    large = bytes(300_000)
    for authorized in (False, True):
        left, right = connected(local_identity, listening)
        if authorized:
            right.raise_unit_limit(len(large))
        assert (received(left, right, large) == large) is authorized
        for sock in (left, right):
            sock.close()


def received(left: RosSocket, right: RosSocket, unit: bytes) -> bytes:
    """What arrives of one unit."""

    def send() -> None:
        with contextlib.suppress(OSError, ChannelError):
            left.send_unit(unit)

    thread, data = background(send), b""
    with contextlib.suppress(ConnectionResetError):
        while len(data) < len(unit):
            data += right.recv(len(unit))
    right.abort()
    thread.join(30)
    return data


class Calls:
    """A service filter that lets requests pass, or refuses them."""

    def __init__(self) -> None:
        self.framing = Framing(FrameReader())
        self.refused = False

    def incoming(self, data: bytes) -> tuple[bytes, tuple[bytes, ...]]:
        ready = b"".join(self.framing.feed(data, 0))
        return (b"", (b"refused: ", ready)) if self.refused and ready else (ready, ())

    def outgoing(self, data: bytes) -> tuple[bytes, ...]:
        return (data,)


def test_calls_pass_the_filter_before_the_program_reads_them(
    local_identity: LocalIdentity, listening: RosSocket
) -> None:
    left, right = connected(local_identity, listening)
    filtering: Any = Calls()
    right.service_filter = filtering
    left.sendall(b"\x07\0\0\0on")
    left.sendall(b" and ")
    assert right.recv(4) == b"on a"
    assert right.recv(100) == b"nd "
    for sock in (left, right):
        sock.close()


def test_a_refused_call_is_answered_and_not_read(local_identity: LocalIdentity, listening: RosSocket) -> None:
    left, right = connected(local_identity, listening)
    calls: Any = Calls()
    right.service_filter, calls.refused = calls, True
    read: list[bytes] = []

    def receive() -> None:
        with contextlib.suppress(ConnectionResetError):
            read.append(right.recv(4))

    thread = background(receive)
    left.sendall(b"\x03\0\0\0off")
    assert left.recv(100) == b"refused: off"
    left.shutdown()
    thread.join(30)
    assert read in ([], [b""])
    for sock in (left, right):
        sock.close()
