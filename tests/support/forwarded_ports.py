"""A forwarded port without a relay: connections led to the two ports of a node, told apart as relays do."""

import contextlib
import socket
import struct
import threading
from collections.abc import Iterator
from typing import Final

from rossec.channel.opening import WireProtocol, first_bytes
from rossec.ros.names import build_forwarded_port

HOST: Final = "127.0.0.1"
_RESET: Final = struct.pack("ii", 1, 0)  # linger: with nothing
_OPENING: Final = first_bytes(WireProtocol.TCPROS)


class ForwardedPort:
    """Listens on loopback for the node whose API and topics are at these ports.

    Attributes:
        opened: the protocol of each connection so far.
        away: whether the other site is out of reach: callers are reset.
    """

    def __init__(self, api: int, topics: int) -> None:
        self._ports = {WireProtocol.HTTP: api, WireProtocol.TCPROS: topics}
        self._server = socket.create_server((HOST, 0))
        self.port: int = self._server.getsockname()[1]
        self.uri = build_forwarded_port(HOST, self.port)
        self.opened: list[WireProtocol] = []
        self.away = False
        self._callers: set[socket.socket] = set()
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self) -> None:
        with contextlib.suppress(OSError):  # how the end appears
            while True:
                threading.Thread(target=self._lead, args=self._server.accept()[:1]).start()

    def _lead(self, caller: socket.socket) -> None:
        with caller, contextlib.suppress(OSError):
            caller.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _RESET)
            self._callers.add(caller)
            if self.away:
                return
            data = caller.recv(len(_OPENING), socket.MSG_WAITALL)
            protocol = WireProtocol.TCPROS if data == _OPENING else WireProtocol.HTTP
            self.opened.append(protocol)
            with socket.create_connection((HOST, self._ports[protocol])) as node:
                node.sendall(data)
                back = threading.Thread(target=_pump, args=(node, caller))
                back.start()
                _pump(caller, node)
                back.join()

    def cut(self) -> None:
        """The other site is out of reach from now on: reset every connection."""
        self.away = True
        for caller in self._callers:
            with contextlib.suppress(OSError):  # it has ended
                caller.shutdown(socket.SHUT_RDWR)

    def close(self) -> None:
        """Admit nobody any more."""
        self._server.shutdown(socket.SHUT_RDWR)
        self._server.close()


@contextlib.contextmanager
def forwarded_port(api: int, topics: int) -> Iterator[ForwardedPort]:
    """A forwarded port while the block runs."""
    made = ForwardedPort(api, topics)
    try:
        yield made
    finally:
        made.close()


def _pump(source: socket.socket, sink: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(1 << 16):
            sink.sendall(data)
    with contextlib.suppress(OSError):
        sink.shutdown(socket.SHUT_WR)
