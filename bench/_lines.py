"""Cheap connections to a master: only the master is measured.

Requests are encoded, and for our master sealed, before the clock starts; while it runs a line only
sends bytes and sees where an answer ends; answers are opened and looked at afterwards. So both
masters have the same load, whose price is that of the system calls.
"""

import secrets
import select
import socket
import time
from collections.abc import Iterable, Sequence

from ca.certificates import Identity
from rossec.channel.connection import Connection
from rossec.channel.edhoc.credentials import Credentials, Verify
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.negotiation import Authenticated, UnitReceived
from rossec.channel.opening import WireProtocol
from rossec.channel.records import HEADER, Frame
from rossec.ros import calls, xmlrpc
from rossec.ros.calls import CallClient
from tests.support.wire import receive

_HEAD = (
    b"POST / HTTP/1.1\r\nHost: 127.0.0.1:11311\r\n"
    b"Content-Type: text/xml\r\nUser-Agent: Python-xmlrpc/3.11\r\nContent-Length: %d\r\n\r\n"
)
_END = b"</methodResponse>\n"
WITHIN = 30  # seconds for an answer: a benchmark that fails says so, and does not hang
_BUFFER = memoryview(bytearray(1 << 20))


Call = tuple[str, *tuple[object, ...]]
"""Method and parameters."""


def request(method: str, *params: object) -> bytes:
    """A call as rospy sends it, but without an offer to take gzip."""
    body = xmlrpc.dump_call(method, params)
    return _HEAD % len(body) + body


class Line:
    """A plain connection; one answer at a time is on its way."""

    def __init__(self, port: int) -> None:
        self.sock = socket.create_connection(("127.0.0.1", port), WITHIN)
        self.sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._data = b""

    def write(self, call: Call) -> bytes:
        """The bytes of a call; all that are written must be sent, in this order."""
        method, *params = call
        return request(method, *params)

    def ready(self, requests: Iterable[bytes]) -> list[bytes]:
        """The bytes to send for each; they must be sent in this order, and all of them."""
        return list(requests)

    def answer(self) -> bytes | None:
        """The bytes of an answer, or None while it is not whole; called when readable."""
        count = self.sock.recv_into(_BUFFER)  # a new megabyte for each costs more than the call
        assert count > 0, "the master hung up"
        data = self._data + _BUFFER[:count]
        whole = self.is_whole(data)
        self._data = b"" if whole else data
        return data if whole else None

    def is_whole(self, data: bytes) -> bool:
        """Whether these are all the bytes of an answer."""
        return data.endswith(_END)

    def body(self, answer: bytes) -> bytes:
        """The body of an answer; they must be opened in order."""
        head, _, body = answer.partition(b"\r\n\r\n")
        assert b"content-length: %d\r\n" % len(body) in head.lower() + b"\r\n", head
        return body

    def check(self, body: bytes) -> None:
        """Check that an answer is a success."""
        assert b"<int>1</int>" in body or b"<i4>1</i4>" in body, body

    def ask(self, data: bytes) -> bytes:
        """One request, not measured."""
        for each in self.ready([data]):
            self.sock.sendall(each)
        while (answer := self.answer()) is None:
            pass
        return self.body(answer)


class SecureLine(Line):
    """The same over rossec's channel."""

    def __init__(self, port: int, own: Credentials, verify: Verify[Identity]) -> None:
        super().__init__(port)
        config = EdhocConfig(own, verify, secrets.token_bytes)
        self._core = Connection[Identity].initiator(config, now=int(time.time()), opening=WireProtocol.HTTP)
        authenticated = False
        while not authenticated:
            self.sock.sendall(self._core.data_to_send())
            events = self._open(self.sock.recv(1 << 16))
            authenticated = any(isinstance(event, Authenticated) for event in events)
        self.sock.sendall(self._core.data_to_send())

    def _open(self, data: bytes) -> list[object]:
        return list(receive(self._core, data, int(time.time())))

    def ready(self, requests: Iterable[bytes]) -> list[bytes]:
        return [b"".join(self._core.seal_unit(data)) for data in requests]

    def is_whole(self, data: bytes) -> bool:
        begin, kind = 0, 0
        while len(data) - begin >= HEADER:
            kind = data[begin] >> 4
            begin += HEADER + int.from_bytes(data[begin + 1 : begin + HEADER])
        return begin == len(data) and kind == Frame.DATA_END

    def unit(self, answer: bytes) -> bytes:
        """What the records of an answer hold."""
        events = self._open(answer)
        return b"".join(each.data for each in events if isinstance(each, UnitReceived))

    def body(self, answer: bytes) -> bytes:
        return super().body(self.unit(answer))


class CompactLine(SecureLine):
    """The same with calls in the compact form."""

    def __init__(self, name: str, port: int, own: Credentials, verify: Verify[Identity]) -> None:
        super().__init__(port, own, verify)
        calls = CallClient("127.0.0.1")
        self._written = self._answered = 0
        calls.take(self.ask(calls.request("getPid", (name,))))
        assert calls.is_compact

    def write(self, call: Call) -> bytes:
        method, *params = call
        self._written += 1
        return calls.dump_compact_call(self._written % calls.TURNS, method, params)

    def body(self, answer: bytes) -> bytes:
        return self.unit(answer)

    def check(self, body: bytes) -> None:
        self._answered += 1
        answer = calls.load_compact_answer(body, self._answered % calls.TURNS, "")
        assert isinstance(answer, list), answer
        assert answer[0] == 1, answer


def drive(lines: Sequence[Line], requests: Sequence[Sequence[bytes]]) -> float:
    """Let every line send its requests, all lines at once, each waiting for its answer.

    Every answer must be a success. Returns the seconds it took.
    """
    poll = select.epoll()
    ready = [line.ready(asked) for line, asked in zip(lines, requests, strict=True)]
    answers: list[list[bytes]] = [[] for _ in lines]
    where = {line.sock.fileno(): number for number, line in enumerate(lines)}
    left = len(lines)
    begin = time.perf_counter()
    for number, line in enumerate(lines):
        poll.register(line.sock.fileno(), select.EPOLLIN)
        line.sock.sendall(ready[number][0])
    with poll:
        while left:
            ready_fds = poll.poll(WITHIN)
            assert ready_fds, f"no answer to {left} of {len(lines)} lines within {WITHIN} s"
            for fd, _ in ready_fds:
                number = where[fd]
                line, got = lines[number], answers[number]
                answer = line.answer()
                if answer is None:
                    continue
                got.append(answer)
                if len(got) < len(ready[number]):
                    line.sock.sendall(ready[number][len(got)])
                else:
                    left -= 1
    taken = time.perf_counter() - begin
    for line, got in zip(lines, answers, strict=True):
        for answer in got:
            line.check(line.body(answer))
    return taken
