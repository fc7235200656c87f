"""An observer of the network, or a peer of another authority, learns nothing: attacks F8 and D3."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import pytest

from rossec.errors import PeerRefused
from rossec.net.aio import WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from tests.support.attacker import EVE, HOST, credentials, dial, fields_for, send_header, signed
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import FRAME, POSE, TOPIC, Witness


class Recorder:
    """Records every byte of both directions."""

    def __init__(self, port: int) -> None:
        self._to = port
        self.recorded = bytearray()

    async def _pass_on(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(65536):
                self.recorded += data
                writer.write(data)
                await writer.drain()
        writer.close()

    async def handle(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection(HOST, self._to)
        await asyncio.gather(self._pass_on(reader, far_writer), self._pass_on(far_reader, writer))


@contextlib.asynccontextmanager
async def recording(port: int) -> AsyncIterator[tuple[Recorder, int]]:
    """A port that forwards to `port`, and records."""
    recorder = Recorder(port)
    async with await asyncio.start_server(recorder.handle, HOST, 0) as server:
        yield recorder, server.sockets[0].getsockname()[1]


def holds_none(recorder: Recorder, *secrets: bytes) -> None:
    assert len(recorder.recorded) > 500, "nothing was recorded"
    assert [secret for secret in secrets if secret in recorder.recorded] == []


@pytest.mark.attack("read-network")
async def test_f8_an_observer_sees_neither_names_nor_grants(site: Site, witness: Witness) -> None:
    assert site.master is not None
    grant = signed(site)
    async with recording(site.master.port) as (recorder, port):
        client = RpcClient(await dial(f"http://{HOST}:{port}/", credentials(site)))
        assert await client.ask("rossec.presentGrants", EVE, [grant]) == 1
        assert await client.ask("registerSubscriber", EVE, TOPIC, POSE, "http://127.0.0.1:9/")
        await client.close()
        holds_none(recorder, TOPIC.encode(), POSE.encode(), b"/eve", b"Grants", grant[-64:], grant[:64])
    async with recording(witness.topic_port) as (recorder, port):
        heard = await send_header(port, credentials(site), fields_for(EVE, TOPIC, [grant]), 2000)
        assert FRAME.encode() in heard.after
        holds_none(recorder, TOPIC.encode(), FRAME.encode(), b"PoseStamped", b"/eve", grant[-64:])


@pytest.mark.attack("foreign-authority")
async def test_f8_a_peer_of_another_authority_gets_only_a_refusal(site: Site, witness: Witness) -> None:
    """The peer may complete the handshake with certificates of its own."""
    assert site.master is not None
    intruder = credentials(Site(site.root.parent / "other", site.anchor.domain), "/viewer")
    shown: list[tuple[bytes, ...]] = []

    def look(chain: tuple[bytes, ...], now: int) -> Any:
        shown.append(chain)
        return site.anchor.verify(chain, now)

    async def heard(port: int, opening: WireProtocol) -> bytes:
        stream = await connect(HOST, port, unlimited(intruder, look), opening)
        return await stream.receive()

    for port, opening in ((site.master.port, WireProtocol.HTTP), (witness.topic_port, WireProtocol.TCPROS)):
        async with recording(port) as (recorder, near):
            with pytest.raises(PeerRefused) as caught:
                await heard(near, opening)
            secrets = TOPIC, POSE, FRAME, "/viewer"
            holds_none(recorder, *[secret.encode() for secret in secrets])
            assert not [secret for secret in secrets if secret in str(caught.value)]
    own = b"".join(b"".join(chain) for chain in shown)  # all it could decrypt
    assert TOPIC.encode() not in own
    assert b"spiffe://home/viewer" not in own
