"""Secure sockets for threads over loopback: pairs of them, and reading from them."""

import select
import socket
import threading
from collections.abc import Callable
from typing import Any

from rossec.channel.records import ChannelLimits
from rossec.net.context import SecureContext
from rossec.net.threads.secure_socket import SecureSocket
from tests.support.contexts import context
from tests.support.listener import SecureListener
from tests.support.wire import ALICE, BOB, DEFAULTS, FakeIdentity

Secure = SecureSocket[FakeIdentity]


def make_listener(limits: ChannelLimits = DEFAULTS, **options: Any) -> SecureListener[FakeIdentity]:
    sock = socket.create_server(("127.0.0.1", 0))
    return SecureListener(sock, context(BOB, limits=limits, **options))


def dial(listener: Any, own: SecureContext[FakeIdentity]) -> Secure:
    """Connect to a listening socket."""
    sock = Secure.initiate(socket.create_connection(listener.getsockname()), own, timeout=5)
    sock.settimeout(5)
    return sock


def background(work: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def pair(listener: SecureListener[FakeIdentity], limits: ChannelLimits = DEFAULTS) -> tuple[Secure, Secure]:
    accepted: list[Secure] = []

    def accept() -> None:
        sock, _ = listener.accept()
        sock.do_handshake()
        accepted.append(sock)

    thread = background(accept)
    left = dial(listener, context(ALICE, limits=limits))
    thread.join(30)
    return left, accepted[0]


def read(sock: Secure, size: int) -> bytes:
    got = bytearray()
    while len(got) < size:
        chunk = sock.recv(1 << 20)
        assert chunk
        got += chunk
    return bytes(got)


def readable(sock: Secure) -> bool:
    poll = select.poll()
    poll.register(sock._socket, select.POLLIN)
    return len(poll.poll(50)) > 0
