"""The UDP socket of a border router, and its clock."""

import asyncio
import os
import socket

import pytest
from aiocoap.numbers import codes
from cryptography.hazmat.primitives.asymmetric import ec

from ca.things import ThingKey
from rossec.border import messages
from rossec.border.border_router import Server
from rossec.border.conversations import Conversation
from rossec.border.endpoint import CoapAnswer, CoapRequest
from rossec.border.handshakes import StaticKey
from rossec.border.messages import OscoreContext
from rossec.errors import ConfigurationError, ThingUnreachable

OWN = StaticKey(ec.generate_private_key(ec.SECP256R1()))
LAMP = "/things/lamp"


class Nobody:
    """Serves nothing, and is told what ends."""

    def __init__(self) -> None:
        self.gone: list[str] = []

    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None:
        return None

    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None:
        return None

    def registered(self, conversation: Conversation) -> None:
        raise AssertionError

    def left(self, name: str) -> None:
        raise AssertionError

    def ended(self, conversation: Conversation) -> None:
        self.gone.append(conversation.name)


class Peer(asyncio.DatagramProtocol):
    """What a thing hears."""

    def __init__(self) -> None:
        self.heard: asyncio.Queue[bytes] = asyncio.Queue()
        self.transport: asyncio.DatagramTransport

    async def start(self, address: tuple[str, int]) -> None:
        loop = asyncio.get_running_loop()
        self.transport, _ = await loop.create_datagram_endpoint(lambda: self, remote_addr=address)

    def datagram_received(self, data: bytes, addr: object) -> None:
        self.heard.put_nowait(data)

    async def next(self) -> bytes:
        return await asyncio.wait_for(self.heard.get(), 10)


async def test_datagrams_come_and_go() -> None:
    nobody, peer = Nobody(), Peer()
    server = Server(OWN, nobody, nobody, "::1", 0)
    await peer.start(server.address)
    for number in range(100):
        peer.transport.sendto(messages.empty(messages.CON, number))
        assert await peer.next() == messages.empty(messages.RST, number)
    assert server.endpoint.counts.datagrams == 100
    server.close()
    peer.transport.close()


async def test_requests_are_sent_again_and_fail_when_the_conversation_ends(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("rossec.border.messages.ACK_TIMEOUT", 0.05)
    nobody, peer = Nobody(), Peer()
    server = Server(OWN, nobody, nobody, "::1", 0)
    await peer.start(server.address)
    answers: list[CoapAnswer | ThingUnreachable] = []
    request = CoapRequest(codes.GET, ("t",))
    assert server.request(LAMP, request, answers.append) is None
    address = peer.transport.get_extra_info("sockname")
    context = OscoreContext(os.urandom(16), b"", b"a", b"b")
    server.endpoint.conversations.add(Conversation(LAMP, context, address))
    cancel = server.request(LAMP, request, answers.append)
    assert await peer.next() == await peer.next()
    assert server.request(LAMP, request, answers.append) is not None
    assert cancel is not None
    cancel()
    server.drop(LAMP)
    assert nobody.gone == [LAMP]
    assert len(answers) == 1
    assert isinstance(answers[0], ThingUnreachable)
    server.close()
    peer.transport.close()


async def test_a_thing_is_answered_at_once_in_a_flood_of_strangers() -> None:
    """All of the flood is in the socket before the thing's datagram."""
    nobody, peer, flood = Nobody(), Peer(), Peer()
    server = Server(OWN, nobody, nobody, "::1", 0)
    await peer.start(server.address)
    await flood.start(server.address)
    address = peer.transport.get_extra_info("sockname")
    context = OscoreContext(os.urandom(16), b"", b"a", b"b")
    server.endpoint.conversations.add(Conversation(LAMP, context, address))
    for number in range(400):
        flood.transport.sendto(messages.empty(messages.CON, number))
    peer.transport.sendto(messages.empty(messages.CON, 7))
    assert await peer.next() == messages.empty(messages.RST, 7)
    assert server.endpoint.counts.datagrams < 50
    server.close()
    for end in (peer, flood):
        end.transport.abort()  # what the kernel has not taken is not waited for


async def test_a_port_is_taken_once() -> None:
    nobody = Nobody()
    server = Server(OWN, nobody, nobody, "::1", 0)
    with pytest.raises(ConfigurationError, match=r"cannot listen at ::1 port") as caught:
        Server(OWN, nobody, nobody, "::1", server.address[1])
    assert "another border router" in caught.value.hint
    server.close()
    with pytest.raises(ConfigurationError, match=r"cannot listen at 2001:db8::1") as caught:
        Server(OWN, nobody, nobody, "2001:db8::1", 0)
    assert "--listen" in caught.value.hint


async def test_everywhere_is_ipv4_too() -> None:
    nobody, peer = Nobody(), Peer()
    server = Server(OWN, nobody, nobody, "::", 0)
    await peer.start(("127.0.0.1", server.address[1]))
    peer.transport.sendto(messages.empty(messages.CON, 1))
    assert await peer.next() == messages.empty(messages.RST, 1)
    server.close()
    peer.transport.close()


async def test_a_peer_that_is_gone_ends_nothing() -> None:
    nobody, peer = Nobody(), Peer()
    server = Server(OWN, nobody, nobody, "127.0.0.1", 0)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as gone:
        gone.bind(("127.0.0.1", 0))
        gone.sendto(messages.empty(messages.CON, 1), server.address)
    await peer.start(server.address)
    peer.transport.sendto(messages.empty(messages.CON, 2))
    assert await peer.next() == messages.empty(messages.RST, 2)
    server.close()
    peer.transport.close()
