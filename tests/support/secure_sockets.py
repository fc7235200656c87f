"""Secure sockets for threads over loopback: pairs of them, and reading from them."""

import select
import socket
import threading
from collections.abc import Callable

from rossec.net.threads.secure_socket import SecureSocket
from tests.support.listener import SecureListener
from tests.support.wire import ALICE, BOB, FakeIdentity, trust

Secure = SecureSocket[FakeIdentity]


def live(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
    found = trust(chain, now)
    return FakeIdentity(found.name, found.public_key, found.certificate, 1 << 40)


def make_listener(**options: object) -> SecureListener[FakeIdentity]:
    sock = socket.create_server(("127.0.0.1", 0))
    return SecureListener(sock, BOB, live, **options)  # type: ignore[arg-type]  # passed on


def background(work: Callable[[], object]) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


def pair(listener: SecureListener[FakeIdentity], **options: object) -> tuple[Secure, Secure]:
    accepted: list[Secure] = []

    def accept() -> None:
        sock, _ = listener.accept()
        sock.do_handshake()
        accepted.append(sock)

    thread = background(accept)
    left = Secure.connect(listener.getsockname(), ALICE, live, 5, **options)
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
    poll.register(sock, select.POLLIN)
    return len(poll.poll(50)) > 0
