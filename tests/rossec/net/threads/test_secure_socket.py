"""The blocking driver: threads, timeouts, polls."""

import contextlib
import itertools
import secrets
import select
import socket
from functools import partial

import pytest

from rossec.channel.connection import Connection
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelClosed, ChannelError, ConnectionTruncated, IdentityRefused
from rossec.net.threads.secure_socket import SecureSocket
from tests.support.contexts import context, live
from tests.support.listener import SecureListener
from tests.support.secure_sockets import Secure, background, dial, pair, read, readable
from tests.support.wire import ALICE, BOB, FakeIdentity


def test_bytes_there_and_back(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        assert left.peer is not None
        assert right.peer is not None
        assert (left.peer.name, right.peer.name) == ("/bob", "/alice")
        left.sendall(b"hello")
        assert right.recv(3) == b"hel"
        buffer = bytearray(10)
        assert right.recv_into(buffer) == 2
        assert buffer[:2] == b"lo"
        right.sendall(b"world")
        assert left.recv_into(buffer, 4) == 4
        assert left.recv(10) == b"d"
        assert left._socket.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)


def test_large_both_ways_at_once(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    size = 20_000_000
    with left, right:
        threads = [background(lambda s=s: s.sendall(bytes(size))) for s in (left, right)]  # type: ignore[misc]  # a loop variable
        other = background(lambda: read(left, size))
        assert read(right, size) == bytes(size)
        for thread in (*threads, other):
            thread.join(30)
            assert not thread.is_alive()


def test_timeouts(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        left.settimeout(0.01)
        assert left.gettimeout() == 0.01
        with pytest.raises(TimeoutError):
            left.recv(1)
        left.settimeout(0)
        with pytest.raises(BlockingIOError):
            left.recv(1)
        left.settimeout(None)
        right.sendall(b"x")
        assert left.recv(1) == b"x"
        right.settimeout(0.05)
        with pytest.raises(TimeoutError):
            right.sendall(bytes(50_000_000))
        with pytest.raises(ChannelClosed, match="half-way"):
            right.sendall(b"x")


def test_a_close_and_a_truncation_differ(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with right:
        left.shutdown(socket.SHUT_RD)
        left.shutdown(socket.SHUT_WR)
        assert right.recv(1) == b""
        assert left.recv(1) == b""
        with pytest.raises(ChannelClosed):
            left.sendall(b"x")
        left.close()
        left.close()
    left, right = pair(listener)
    with left, right:
        left._socket.close()
        with pytest.raises(ConnectionTruncated):
            right.recv(1)
        with pytest.raises(ChannelError):
            right.recv(1)


def test_shutdown_wakes_a_reader(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        got: list[bytes] = []
        thread = background(lambda: got.append(right.recv(1)))
        thread.join(0.05)
        right.shutdown()
        thread.join(30)
        assert got == [b""]


def test_sending_first_makes_the_handshake(listener: SecureListener[FakeIdentity]) -> None:
    def serve() -> None:
        sock, _ = listener.accept()
        with sock:
            sock.sendall(b"first")
            sock.recv(1)

    thread = background(serve)
    with dial(listener, context(ALICE)) as left:
        assert left.recv(5) == b"first"
    thread.join(30)


def test_keys_are_renewed_while_data_flows(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener, limits=ChannelLimits(records=3))
    with left, right:
        for count in range(40):
            left.sendall(b"%02d" % count)
            assert right.recv(2) == b"%02d" % count
            right.sendall(b"ok")
            assert left.recv(2) == b"ok"


def test_the_listener_is_a_socket_to_its_user(listener: SecureListener[FakeIdentity]) -> None:
    assert listener.fileno() >= 0

    def wait() -> None:
        with pytest.raises(OSError, match=r"\[Errno"):
            listener.accept()

    thread = background(wait)
    thread.join(0.05)
    listener.shutdown(socket.SHUT_RDWR)
    thread.join(30)
    assert not thread.is_alive()


def test_units_are_handed_out_whole(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        left.sendall(b"one ", b"unit")
        left.sendall(b"another")
        assert right.receive_unit() == b"one unit"
        assert right.recv(3) == b"ano"
        rest = right.receive_unit()
        assert bytes(rest) == b"ther"
        left.close()
        assert right.receive_unit() == b""


def test_a_side_that_only_sends_follows_its_peer(listener: SecureListener[FakeIdentity]) -> None:
    """Renewals are answered, units are dropped, a close is noticed."""
    left, right = pair(listener, limits=ChannelLimits(records=2))
    with left, right:
        for number in range(20):
            while left.awaits_peer:
                left.pump()
            left.sendall(b"%d" % number)
            assert right.recv(10) == b"%d" % number
        right.sendall(b"not asked for")
        right.close()
        while True:
            left.pump()
            try:
                left.sendall(b"x")
            except ChannelClosed:
                break


def test_a_socket_may_be_given_back(listener: SecureListener[FakeIdentity]) -> None:
    with socket.create_connection(listener.getsockname()) as plain:
        accepted, _ = listener.accept()
        plain.sendall(b"hello")
        with accepted.detach() as sock:
            assert sock.recv(10) == b"hello"
            accepted.close()
            assert sock.fileno() >= 0


def test_try_send_does_not_wait(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        assert left.try_send(b"0000")
        with left._writing:
            assert not left.try_send(b"busy")
        assert not left.try_send(bytes(100_000)), "more than one record"
        number = 0
        while not left.unsent:
            number += 1
            assert left.try_send(b"%04d" % number * 1000)
        assert not left.try_send(b"later")
        sender = background(left.sendall)
        got = read(right, 4 + number * 4000)
        sender.join(30)
        assert not left._core.has_data_to_send
        assert got == b"0000" + b"".join(b"%04d" % count * 1000 for count in range(1, number + 1))
        left.sendall(b"after")
        assert right.recv(10) == b"after"


def test_try_send_without_a_peer_sends_nothing(listener: SecureListener[FakeIdentity]) -> None:
    sock = socket.create_connection(listener.getsockname())
    core = Connection[FakeIdentity].initiator(EdhocConfig(ALICE, live, secrets.token_bytes), now=0)
    with SecureSocket(sock, core) as secure:
        assert not secure.try_send(b"x")


def test_try_send_raises_after_the_end(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with right, left:
        left._socket.shutdown(socket.SHUT_RDWR)
        with pytest.raises(ChannelClosed, match="closed"):
            left.try_send(b"x")
        with pytest.raises(ChannelClosed):
            left.try_send(b"x")


def test_an_aborted_connection_delivers_nothing_more(listener: SecureListener[FakeIdentity]) -> None:
    """Neither what was decrypted, nor what waits in the kernel."""
    left, right = pair(listener)
    with left, right:
        left.sendall(b"one")
        assert right.recv(1) == b"o"
        left.sendall(b"two")
        assert readable(right)
        right.disconnect()
        right.abort("once is enough")
        assert right.recv(10) == b""
        assert right.receive_unit() == b""
        with pytest.raises(ChannelClosed):
            right.sendall(b"x")


def test_an_abort_wakes_a_reader(listener: SecureListener[FakeIdentity]) -> None:
    left, right = pair(listener)
    with left, right:
        got: list[bytes] = []
        thread = background(lambda: got.append(right.recv(1)))
        thread.join(0.05)
        right.abort()
        thread.join(5)
        assert got == [b""]


def test_pump_is_bounded_under_a_flood(
    listener: SecureListener[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A peer that talks without end to a side that only sends is read a bounded amount."""
    monkeypatch.setattr("rossec.net.threads.secure_socket.PUMPED", 3)
    left, right = pair(listener)
    with left, right:
        taken = itertools.count()
        monkeypatch.setattr(left, "_take_in", lambda *_: next(taken) >= 0)
        left.pump()
        assert next(taken) == 3


def test_run_timers_renews_the_keys_of_an_idle_connection(listener: SecureListener[FakeIdentity]) -> None:
    """Without reads and writes, renewals are begun and followed, and units stay."""
    left, right = pair(listener, limits=ChannelLimits(seconds=1))
    with left, right:
        left.sendall(b"map")
        assert right.recv(10) == b"map"
        for side in (left, right, left, right):
            side._core._session.renew_at = 0  # type: ignore[union-attr]
            side._timers_run_at = -1
            side.run_timers()
        assert left._core._session.receive_epoch == 1  # type: ignore[union-attr]
        left.sendall(b"kept")
        select.poll().poll(50)
        right.run_timers()
        right.run_timers()
        assert right.recv(10) == b"kept"
        with left._writing:
            left.run_timers()
        with left._reading:
            left.run_timers()
        right.close()
        with contextlib.suppress(ChannelError):
            for _ in range(3):
                left.run_timers()
        assert left.recv(1) == b""


def answer(listener: SecureListener[FakeIdentity], callers: int = 1) -> None:
    """Accept so many callers, one after another."""
    for _ in range(callers):
        accepted, _ = listener.accept()
        with accepted, contextlib.suppress(ChannelError):
            accepted.do_handshake()


def test_an_initiator_waits_no_longer_than_it_may(listener: SecureListener[FakeIdentity]) -> None:
    own = socket.create_connection(listener.getsockname())
    with pytest.raises(TimeoutError):
        Secure.initiate(own, context(ALICE), timeout=0.05)
    assert own.fileno() == -1


def test_an_initiator_reaches_itself_where_it_means_to() -> None:
    own = context(BOB)

    with SecureListener(socket.create_server(("127.0.0.1", 0)), own) as listener:
        thread = background(partial(answer, listener, 2))
        sock = socket.create_connection(listener.getsockname())
        with Secure.initiate(sock, own, to_itself=True, timeout=5) as secure:
            assert secure.peer is not None
            assert secure.peer.name == "/bob"
            assert secure.gettimeout() is None
        sock = socket.create_connection(listener.getsockname())
        with pytest.raises(IdentityRefused):
            Secure.initiate(sock, own, timeout=5)
        assert sock.fileno() == -1
        thread.join(30)
