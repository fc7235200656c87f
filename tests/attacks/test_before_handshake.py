"""What arrives before the handshake is never parsed as a call: attacks F9 and M10."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from rossec.master.operation.config import MasterLimits
from rossec.ros import xmlrpc
from tests.support.attacker import EVE, HOST
from tests.support.site import Site
from tests.support.witness import until

T = "std_msgs/String"
CALL = xmlrpc.dump_call("registerPublisher", (EVE, "/t", T, "http://127.0.0.1:9/"))
POST = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(CALL) + CALL
OPENING = b"GET /rossec HTTP/1.1\r\nHost: rossec\r\nConnection: Upgrade\r\nUpgrade: rossec/1\r\n\r\n"
HEAD = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n"


@pytest.fixture
async def impatient(tmp_path: Path) -> AsyncIterator[Site]:
    """A site whose master waits a second for a handshake."""
    site = Site(tmp_path / "impatient")
    site.limits = MasterLimits(handshake_seconds=1)
    async with site.running():
        yield site


@pytest.mark.attack("plain-peer")
@pytest.mark.parametrize(
    "data",
    [
        POST,
        b"x" + POST,
        b"\r\n" + POST,
        OPENING + POST,
        OPENING + b"\x00" * 40 + POST,
        OPENING + b"\xff" * 5000 + POST,
        OPENING[:-2] + POST,
        OPENING.replace(b"rossec/1", b"websocket") + POST,
        OPENING.replace(b"GET", b"POST") + POST,
        POST + OPENING,
        b"\x14\x00\x00\x00\x10\x00\x00\x00callerid=/viewer" + POST,
    ],
)
async def test_f9_data_before_the_handshake_is_not_a_call(site: Site, data: bytes) -> None:
    """There is one parser, and what it refuses is not passed to another."""
    assert site.master is not None
    loop = asyncio.get_running_loop()
    with socket.socket() as sock:
        sock.setblocking(False)
        await loop.sock_connect(sock, (HOST, site.master.port))
        await loop.sock_sendall(sock, data)
        sock.shutdown(socket.SHUT_WR)
        with contextlib.suppress(ConnectionError):
            async with asyncio.timeout(20):
                while await loop.sock_recv(sock, 4096):
                    pass
    assert site.master.status()["calls"] == 0
    assert not list(site.master.state.registry.nodes())


@pytest.mark.attack("plain-peer")
async def test_m10_nothing_is_parsed_before_the_handshake(impatient: Site) -> None:
    """A plain caller with an endless body gets one answer; the rest is discarded unread."""
    master = impatient.master
    assert master is not None
    assert master._server is not None
    server = master._server
    loop = asyncio.get_running_loop()
    with socket.socket() as sock:
        sock.setblocking(False)
        await loop.sock_connect(sock, (HOST, master.port))
        await loop.sock_sendall(sock, HEAD % (1 << 40))
        async with asyncio.timeout(60):
            with contextlib.suppress(OSError):  # otherwise the deadline raises
                while True:
                    await loop.sock_sendall(sock, b"<methodCall>" * 5000)
                    await asyncio.sleep(0.01)
    await until(lambda: server.connections == 0)
