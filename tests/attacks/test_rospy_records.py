"""The TCPROS port of a secured rospy node: records that were changed on the way (N11)."""

import asyncio
import contextlib
import secrets
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Final

import pytest
import pytest_asyncio

from ca.certificates import Identity
from grants.model import Right
from rossec.channel.connection import Connection
from rossec.channel.edhoc.handshake import EdhocConfig
from rossec.channel.negotiation import Authenticated, UnitReceived
from rossec.ros import tcpros
from tests.support.attacker import HOST, credentials
from tests.support.victim import SERVICE, Victim, attacked, for_service
from tests.support.wire import receive

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]
NOWHERE: Final = "/robot/none"


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def victim(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Victim]:
    directory: Path = tmp_path_factory.mktemp("victim")
    async with attacked(directory) as victim:
        yield victim


class Wire:
    """A subscriber or a client whose records can be changed."""

    def __init__(self, victim: Victim, name: str) -> None:
        self.sock = socket.create_connection((HOST, victim.port), timeout=10)
        config = EdhocConfig(credentials(victim.site, name), victim.site.anchor.verify, secrets.token_bytes)
        self.core = Connection[Identity].initiator(config, now=int(time.time()))
        self.units: list[bytes] = []
        self.push()
        while not self.pull():
            self.push()
        self.push()

    def push(self) -> None:
        self.sock.sendall(self.core.data_to_send())

    def pull(self) -> bool:
        """Receive; returns whether the peer is authenticated now."""
        data = self.sock.recv(65536)
        assert data, "the connection ended"
        events = receive(self.core, data, int(time.time()))
        self.units += [event.data for event in events if isinstance(event, UnitReceived)]
        return any(isinstance(event, Authenticated) for event in events)

    def seal(self, data: bytes) -> bytes:
        self.core.send_unit(data)
        return bytes(self.core.data_to_send())

    def ended(self) -> bool:
        """Wait until the peer closes the connection."""
        with contextlib.suppress(ConnectionError):
            while self.sock.recv(65536):
                pass
        return True


def tampered(one: bytes, two: bytes) -> bytes:
    return one[:-1] + bytes([one[-1] ^ 1]) + two


def replayed(one: bytes, _: bytes) -> bytes:
    return one + one


def reordered(one: bytes, two: bytes) -> bytes:
    return two + one


def changed_header(one: bytes, two: bytes) -> bytes:
    return bytes([one[0] ^ 0x10]) + one[1:] + two


@pytest.mark.attack("tampered-records")
@pytest.mark.parametrize(
    ("meddle", "called"), [(tampered, 0), (replayed, 1), (reordered, 0), (changed_header, 0)]
)
async def test_tampered_records_end_the_connection(
    victim: Victim, meddle: Callable[[bytes, bytes], bytes], called: int
) -> None:
    """N11: on a service, where each request has an effect."""
    grant = victim.site.grant("/clerk", Right.CALL, SERVICE)
    wire = await asyncio.to_thread(Wire, victim, "/clerk")
    fields = for_service("/clerk", SERVICE, [grant], persistent="1")
    wire.sock.sendall(wire.seal(tcpros.encode(fields)))
    while not wire.units:
        await asyncio.to_thread(wire.pull)
    before = victim.said.count("RESET")
    flight = meddle(wire.seal(tcpros.frame(b"")), wire.seal(tcpros.frame(b"")))
    wire.sock.sendall(flight)
    assert await asyncio.to_thread(wire.ended)
    wire.sock.close()
    await victim.viewer._membership.session.call("getPid")
    assert victim.said.count("RESET") - before <= called
    victim.program.said = victim.said.replace("RESET", "")
    await victim.goes_on()


@pytest.mark.attack("tampered-records")
async def test_a_truncated_record_delivers_nothing(victim: Victim) -> None:
    """N11: truncation; half a request is not a request."""
    grant = victim.site.grant("/clerk", Right.CALL, SERVICE)
    wire = await asyncio.to_thread(Wire, victim, "/clerk")
    fields = for_service("/clerk", SERVICE, [grant])
    wire.sock.sendall(wire.seal(tcpros.encode(fields)))
    wire.sock.sendall(wire.seal(tcpros.frame(b""))[:-1])
    wire.sock.shutdown(socket.SHUT_WR)
    assert await asyncio.to_thread(wire.ended)
    wire.sock.close()
    await victim.goes_on()
