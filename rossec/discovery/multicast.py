"""One datagram group on every link of this host (IPv6, link-local scope).

A shell. Hop limit 255 is sent and required: a router would have lowered it, so what arrives was
sent on the link itself (RFC 5082).
"""

import ipaddress
import socket
import struct
from collections.abc import Iterator
from contextlib import suppress
from typing import Final

from rossec.discovery.candidates import DatagramSource

GROUP: Final = "ff12::726f:7373:6563"  # transient, link-local scope (RFC 4291 section 2.7)
PORT: Final = 11311
_HOPS: Final = 255
_MAX_DATAGRAM: Final = 2048
_ANCILLARY: Final = socket.CMSG_SPACE(struct.calcsize("i")) + socket.CMSG_SPACE(20)


class MulticastSocket:
    """Sends to and receives from the group on every link, also those that come up later."""

    def __init__(self, *, listen: bool, port: int = PORT) -> None:
        self._port = port
        self._socket = socket.socket(socket.AF_INET6, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC)
        try:
            self._set_up(listen=listen)
        except BaseException:
            self._socket.close()
            raise
        self._listens = listen
        self.join()

    def fileno(self) -> int:
        """The descriptor to wait on."""
        return self._socket.fileno()

    def join(self) -> None:
        """Join the group on links that are new; those that cannot multicast are left out."""
        if not self._listens:
            return
        for index, _ in socket.if_nameindex():
            group = socket.inet_pton(socket.AF_INET6, GROUP) + struct.pack("@I", index)
            with suppress(OSError):  # joined already, or no such link any more
                self._socket.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_JOIN_GROUP, group)

    def send(self, data: bytes) -> int:
        """Send to the group on every link; returns on how many it was sent."""
        sent = 0
        for index, _ in socket.if_nameindex():
            with suppress(OSError):  # down, or without IPv6
                self._socket.sendto(data, (GROUP, self._port, 0, index))
                sent += 1
        return sent

    def receive(self) -> Iterator[tuple[bytes, DatagramSource]]:
        """Datagrams that were sent on the links themselves."""
        while True:
            try:
                data, ancillary, flags, where = self._socket.recvmsg(_MAX_DATAGRAM, _ANCILLARY)
            except OSError:  # nothing more, or a link that went down: retrying might never end
                return
            if not flags & socket.MSG_TRUNC and _is_local(where[0], ancillary):
                yield data, DatagramSource(where[0], where[3])

    def close(self) -> None:
        """Leave the group."""
        self._socket.close()

    def _set_up(self, *, listen: bool) -> None:
        self._socket.setblocking(False)
        level = socket.IPPROTO_IPV6
        self._socket.setsockopt(level, socket.IPV6_V6ONLY, 1)
        self._socket.setsockopt(level, socket.IPV6_MULTICAST_HOPS, _HOPS)
        self._socket.setsockopt(level, socket.IPV6_RECVHOPLIMIT, 1)
        if listen:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            self._socket.bind(
                ("::", self._port)
            )  # a group of this scope cannot be bound for all links


def _is_local(address: str, ancillary: list[tuple[int, int, bytes]]) -> bool:
    """Whether a datagram came from this link: by its hop limit and its source."""
    hops = [
        struct.unpack("i", value)[0]
        for level, kind, value in ancillary
        if (level, kind) == (socket.IPPROTO_IPV6, socket.IPV6_HOPLIMIT) and len(value) == 4
    ]
    source = ipaddress.IPv6Address(address)
    return hops == [_HOPS] and (source.is_link_local or source.is_loopback)
