"""A link that is imagined: what is sent on it, and what arrives."""

import socket
from collections.abc import Iterator

from rossec.discovery import local_links
from rossec.discovery.announcement import DatagramSource
from tests.support.witness import until


class Link(local_links.MulticastSocket):
    """A group of which this process is the only member."""

    takes = 1

    def __init__(self, *, listen: bool) -> None:
        super().__init__(listen=listen)
        self.inner, self.outer = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.inner.setblocking(False)
        links.append(self)

    def fileno(self) -> int:
        return self.inner.fileno()

    def send(self, data: bytes) -> int:
        said.append(data)
        return self.takes

    def receive(self) -> Iterator[tuple[bytes, DatagramSource]]:
        yield self.inner.recv(2048), DatagramSource("127.0.0.1", 1)

    def close(self) -> None:
        super().close()
        self.inner.close()
        self.outer.close()


links: list[Link] = []
said: list[bytes] = []


async def receive(data: bytes) -> None:
    await until(lambda: links)
    links[-1].outer.send(data)
