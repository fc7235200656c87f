"""The core below a secure socket: handshakes, refusals, deadlines."""

import contextlib
import dataclasses
import select
import socket
import struct
import threading
import time

import pytest

from rossec.channel.connection import Connection
from rossec.channel.negotiation import GrantsPresented, IdentityRenewed
from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelError, HandshakeTimeout, IdentityRefused, LimitExceeded, PeerRefused
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from rossec.net.threads import secure_socket
from tests.support.contexts import context, live
from tests.support.listener import SecureListener
from tests.support.secure_sockets import Secure, background, dial, make_listener, pair, read
from tests.support.wire import ALICE, BOB, NOW, STRANGER, FakeIdentity, bob, receive, renewed, renews, trust


def test_a_stranger_is_refused(listener: SecureListener[FakeIdentity]) -> None:
    errors: list[BaseException] = []

    def serve() -> None:
        sock, _ = listener.accept()
        with sock:
            try:
                sock.do_handshake()
            except ChannelError as error:
                errors.append(error)

    thread = background(serve)
    left = dial(listener, context(STRANGER))
    with left, pytest.raises(PeerRefused):
        left.recv(1)
    thread.join(30)
    assert isinstance(errors[0], IdentityRefused)


def test_a_false_responder(listener: SecureListener[FakeIdentity]) -> None:
    def refuse_all(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        return trust((STRANGER.chain[0],), now)

    def serve() -> None:
        sock, _ = listener.accept()
        with sock, pytest.raises(PeerRefused):
            sock.do_handshake()

    thread = background(serve)
    with pytest.raises(IdentityRefused):
        dial(listener, context(ALICE, refuse_all))
    thread.join(30)


def test_the_handshake_deadline() -> None:
    listener = make_listener(limits=ChannelLimits(handshake_seconds=1))
    with listener, socket.create_connection(listener.getsockname()):
        sock, _ = listener.accept()
        with sock, pytest.raises(HandshakeTimeout):
            sock.recv(1)


@pytest.mark.parametrize("use", ["sendall", "send_now", "recv"])
def test_a_connection_nobody_used_for_longer_than_the_handshake_may_take(
    listener: SecureListener[FakeIdentity], monkeypatch: pytest.MonkeyPatch, use: str
) -> None:
    """Its confirmation, message_4, has waited in the kernel, without a reader."""
    left, right = pair(listener)
    with left, right:
        if use == "recv":
            right.sendall(b"x")
        select.select([left._socket], [], [])
        monkeypatch.setattr(secure_socket, "_now", lambda: int(time.time()) + 60)
        if use == "recv":
            assert left.recv(1) == b"x"
        elif use == "send_now":
            assert left.try_send(b"x")
            assert right.recv(1) == b"x"
        else:
            left.sendall(b"x")
            assert right.recv(1) == b"x"


def test_a_responder_that_never_confirms(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        core = bob()

        def half_way() -> None:
            sock, _ = server.accept()
            with sock:
                receive(core, sock.recv(65536), NOW)
                sock.sendall(core.data_to_send())
                done.wait()

        done = threading.Event()
        thread = background(half_way)
        left = dial(server, context(ALICE))
        monkeypatch.setattr(secure_socket, "_now", lambda: int(time.time()) + 60)
        with left, pytest.raises(HandshakeTimeout):
            left.sendall(b"x")
        done.set()
        thread.join(30)


def test_half_open_caps() -> None:
    listener = make_listener(half_open=HalfOpenCount(HalfOpenLimits(per_address=1)))
    with listener, socket.create_connection(listener.getsockname()):
        held, _ = listener.accept()
        with socket.create_connection(listener.getsockname()) as refused:
            listener.settimeout(0.05)
            with pytest.raises(TimeoutError):
                listener.accept()
            assert refused.recv(1) == b""
        held.close()
        listener.settimeout(5)
        left, right = pair(listener)
        left.close()
        right.close()


def test_an_expiring_certificate_ends_a_waiting_read() -> None:
    def short(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        found = trust(chain, now)
        return FakeIdentity(found.name, found.public_key, found.certificate, now + 1)

    with make_listener(verify=short) as listener:
        left, right = pair(listener)
        with left, right, pytest.raises(LimitExceeded, match="certificate has expired"):
            right.recv(1)


def test_a_reader_without_a_deadline_runs_the_timers_of_the_core(
    listener: SecureListener[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel waits a slice at a time; between two the clock is looked at."""
    monkeypatch.setattr("rossec.net.threads.secure_socket.SLICE", struct.pack("ll", 0, 20_000))
    left, right = pair(listener)
    with left, right:
        left.settimeout(None)
        expired = threading.Event()

        def wait() -> None:
            with contextlib.suppress(ChannelError):
                left.recv(1)
            expired.set()

        thread = background(wait)
        left._core._peer = dataclasses.replace(live(BOB.chain, 0), not_after=0)
        assert expired.wait(30)
        thread.join(30)


def test_timers_run_once_in_a_second(
    listener: SecureListener[FakeIdentity], monkeypatch: pytest.MonkeyPatch
) -> None:
    left, right = pair(listener)
    with left, right:
        looks: list[int] = []

        def tick(core: object, now: int) -> None:
            if core is left._core:
                looks.append(now)

        monkeypatch.setattr(Connection, "tick", tick)
        start = int(time.time()) + 10
        for second in (start, start, start + 1, start + 1, start + 9):
            monkeypatch.setattr("rossec.net.threads.secure_socket._now", lambda second=second: second)
            left.sendall(b"map")
        assert looks == [start, start + 1, start + 9]


def test_what_the_peer_renews_reaches_who_only_sends() -> None:
    """A publisher's threads never wait for its subscribers' bytes; the newest grants count."""
    accepted: list[Secure] = []
    with make_listener(renews=renews) as listener:

        def accept() -> None:
            sock, _ = listener.accept()
            sock.do_handshake()
            accepted.append(sock)

        thread = background(accept)
        own = context(ALICE, renews=renews)
        left = dial(listener, own)
        thread.join(30)
        [right] = accepted
        left.sendall(b"x")
        assert read(right, 1) == b"x"
        right.sendall(b"x")
        assert read(left, 1) == b"x"
        own.open_streams.present(renewed(ALICE))
        for grants in (b"older", b"newest"):
            assert left.present_grants(grants)
        left.sendall(b"y")
        assert read(right, 1) == b"y"
        assert right.peer is not None
        assert right.peer.certificate == renewed(ALICE)[0]
        heard: list[object] = []
        right.on_renewal(heard.append)
        assert heard == [GrantsPresented(b"newest")]
        own.open_streams.present(renewed(ALICE, 2))
        for _ in range(100):
            right.run_timers()
            if len(heard) > 1:
                break
        assert isinstance(heard[1], IdentityRenewed)
        assert left._core.takes_renewals
        left.close()
        assert not left.present_grants(b"grants")
        right.close()
