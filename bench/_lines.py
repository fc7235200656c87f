"""Lean connections to a master: requests that are encoded already go out, answers come back whole.

The load must cost less than what it loads, so nothing is parsed here but HTTP's length.
"""

import secrets
import select
import socket
import time
from collections.abc import Sequence

from ca.certificates import Identity
from rossec.channel.connection import Connection
from rossec.channel.credentials import Credentials, Verify
from rossec.channel.opening import Flavour
from rossec.channel.states import Authenticated, UnitReceived
from rossec.ros import xmlrpc

_HEAD = (
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1:11311\r\n"
    b"Content-Type: text/xml\r\nUser-Agent: Python-xmlrpc/3.11\r\nContent-Length: %d\r\n\r\n"
)


def request(method: str, *params: object) -> bytes:
    """A call as rospy sends it, but without an offer to take gzip."""
    body = xmlrpc.dump_call(method, params)
    return _HEAD % len(body) + body


class Line:
    """A plain connection."""

    def __init__(self, port: int) -> None:
        self.sock = socket.create_connection(("127.0.0.1", port), 30)
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._data = b""

    def send(self, data: bytes) -> None:
        self.sock.sendall(data)

    def take(self) -> bytes:
        return self.sock.recv(1 << 20)

    def answer(self) -> bytes | None:
        """The body of an answer, or None while it is not whole; called when readable."""
        self._data += self.take()
        head, separator, body = self._data.partition(b"\r\n\r\n")
        if not separator:
            return None
        length = int(head.lower().partition(b"content-length:")[2].partition(b"\r\n")[0])
        if len(body) < length:
            return None
        self._data = b""
        return body

    def ask(self, data: bytes) -> bytes:
        self.send(data)
        while (body := self.answer()) is None:
            pass
        return body


class SecureLine(Line):
    """The same over rossec's channel."""

    def __init__(self, port: int, own: Credentials, verify: Verify[Identity]) -> None:
        super().__init__(port)
        self._core = Connection[Identity].initiator(
            own, verify, random=secrets.token_bytes, now=int(time.time()), opening=Flavour.HTTP
        )
        authenticated = False
        while not authenticated:
            self.sock.sendall(self._core.data_to_send())
            events = self._receive()
            authenticated = any(isinstance(event, Authenticated) for event in events)
        self.sock.sendall(self._core.data_to_send())

    def _receive(self) -> list[object]:
        count = self.sock.recv_into(self._core.get_buffer())
        assert count > 0, "the master hung up"
        return list(self._core.buffer_updated(count, int(time.time())))

    def send(self, data: bytes) -> None:
        flight = self._core.data_to_send()  # also an empty one: nothing may wait before a record
        record = self._core.seal_small(data)
        assert record is not None, "the keys are due for renewal"
        self.sock.sendall(b"".join((flight, record)))

    def take(self) -> bytes:
        return b"".join(event.data for event in self._receive() if isinstance(event, UnitReceived))


def drive(lines: Sequence[Line], requests: Sequence[Sequence[bytes]]) -> None:
    """Let every line ask its requests, all lines at once, each waiting for its answer.

    They are encoded before, and answers are looked at afterwards: the load must cost less than
    what it loads. Every answer must be a success.
    """
    poll = select.epoll()
    asked = dict.fromkeys(range(len(lines)), 1)
    where = {line.sock.fileno(): number for number, line in enumerate(lines)}
    bodies: list[bytes] = []
    for number, line in enumerate(lines):
        poll.register(line.sock.fileno(), select.EPOLLIN)
        line.send(requests[number][0])
    with poll:
        while asked:
            for fd, _ in poll.poll():
                number = where[fd]
                body = lines[number].answer()
                if body is None:
                    continue
                bodies.append(body)
                if asked[number] == len(requests[number]):
                    del asked[number]
                    continue
                lines[number].send(requests[number][asked[number]])
                asked[number] += 1
    for body in bodies:
        assert b"<int>1</int>" in body or b"<i4>1</i4>" in body, body
