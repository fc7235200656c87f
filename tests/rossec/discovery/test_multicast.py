"""Only what was sent on the link itself is received (RFC 5082)."""

import os
import select
import socket
import sys
from collections.abc import Iterator

import pytest

from rossec.discovery import local_links


@pytest.fixture
def group() -> Iterator[local_links.MulticastSocket]:
    found = local_links.MulticastSocket(listen=True, port=0)
    yield found
    found.close()


def received(group: local_links.MulticastSocket, data: bytes, hops: int = 255) -> list[bytes]:
    """What is received of a datagram that this host sends with this hop limit."""
    with socket.socket(fileno=os.dup(group.fileno())) as bound:
        port = bound.getsockname()[1]
    with socket.socket(socket.AF_INET6, socket.SOCK_DGRAM) as sender:
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_UNICAST_HOPS, hops)
        sender.sendto(data, ("::1", port))
    assert select.select([group], [], [], 10)[0]
    return [data for data, source in group.receive() if source.address == "::1"]


def test_a_datagram_of_the_link_is_received(group: local_links.MulticastSocket) -> None:
    assert received(group, b"announcement") == [b"announcement"]


def test_a_datagram_that_was_routed_or_is_too_long_is_dropped(group: local_links.MulticastSocket) -> None:
    assert received(group, b"announcement", hops=254) == []
    assert received(group, bytes(2049)) == []
    assert received(group, bytes(2048)) == [bytes(2048)]


def test_the_source_of_a_datagram_is_on_the_link() -> None:
    def ancillary(hops: int) -> list[tuple[int, int, bytes]]:
        value = hops.to_bytes(4, sys.byteorder)
        return [(socket.IPPROTO_IPV6, socket.IPV6_HOPLIMIT, value)]

    assert local_links._is_local("fe80::1", ancillary(255))
    assert local_links._is_local("fe80::1%lo", ancillary(255))
    assert not local_links._is_local("fe80::1", ancillary(254))
    assert not local_links._is_local("2001:db8::1", ancillary(255))
    assert not local_links._is_local("fe80::1", [])


def test_it_is_sent_on_every_link_that_takes_it(
    group: local_links.MulticastSocket, monkeypatch: pytest.MonkeyPatch
) -> None:
    group.join()  # once more: links that it has joined are left as they are
    assert 0 <= group.send(b"announcement") <= len(socket.if_nameindex())
    monkeypatch.setattr(socket, "if_nameindex", lambda: [(1 << 20, "gone")])
    group.join()
    assert group.send(b"announcement") == 0


def test_an_error_of_the_socket_ends_receiving() -> None:
    group = local_links.MulticastSocket(listen=False)
    group.close()
    assert list(group.receive()) == []
