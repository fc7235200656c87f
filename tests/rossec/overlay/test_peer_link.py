"""The link of a relay to one peer: dialled when it is used, given up when it is not."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator, Callable
from typing import Any, cast

import pytest

from ca.certificates import Identity
from rossec.errors import ChannelError, HandshakeTimeout, PeerUnreachable, RelayRefused
from rossec.net.aio import SecureStream, WireProtocol, connect, serve
from rossec.overlay.documents import Peer
from rossec.overlay.mux import NODE, Role, StreamTarget
from rossec.overlay.relay import IDLE_FOR, PeerLink, PeerLinkState
from rossec.overlay.streams import Streams
from tests.support.contexts import context
from tests.support.relays import echo, program, to_port
from tests.support.wire import ALICE, BOB
from tests.support.witness import until

PEER = Peer("office", "0" * 32, "office", "/relay", "rossec/1/office/" + "a" * 32)
ROBOT = StreamTarget(NODE, "/robot")


class FarRelay:
    """A peer over TCP, whose targets are at this port."""

    def __init__(self, port: int) -> None:
        self._dial = to_port(port)
        self.links: list[SecureStream[Any]] = []
        self.failure: Exception | None = None
        self.refuses = False
        self.dialled = 0
        self.writers: list[asyncio.StreamWriter] = []

    async def serve(self, stream: SecureStream[Any]) -> None:
        self.links.append(stream)
        if self.refuses:
            stream.abort("not this one")
            return
        with contextlib.suppress(ChannelError):
            await Streams(stream, Role.CALLED, "home", self._dial).run()


@contextlib.asynccontextmanager
async def linked(clock: Callable[[], float] | None = None) -> AsyncIterator[tuple[PeerLink, FarRelay]]:
    stack = contextlib.AsyncExitStack()
    far = FarRelay(await stack.enter_async_context(program(echo)))
    server = serve(far.serve, "127.0.0.1", 0, context(BOB), WireProtocol.HTTP)

    async def dial(peer: Peer) -> SecureStream[Identity]:
        assert peer == PEER
        far.dialled += 1
        await asyncio.sleep(0)
        if far.failure is not None:
            raise far.failure
        stream = await connect("127.0.0.1", server.port, context(ALICE), WireProtocol.HTTP)
        return cast("SecureStream[Identity]", stream)

    link = PeerLink(PEER, dial, *(() if clock is None else (clock,)))
    try:
        yield link, far
    finally:
        await link.close()
        await server.close()
        await stack.aclose()
        for writer in far.writers:
            writer.transport.abort()
        await asyncio.sleep(0)


async def used(link: PeerLink, far: FarRelay) -> tuple[asyncio.StreamReader, asyncio.StreamWriter, Any]:
    """A connection that the link carries."""
    with socket.create_server(("127.0.0.1", 0)) as listener:
        program_end = socket.create_connection(listener.getsockname())
        forwarded_port_end, _ = listener.accept()
    carrying = asyncio.ensure_future(link.carry(ROBOT, forwarded_port_end))
    reader, writer = await asyncio.open_connection(sock=program_end)
    far.writers.append(writer)
    return reader, writer, carrying


async def test_it_is_dialled_with_the_first_connection_and_carries_the_others() -> None:
    async with linked() as (link, far):
        assert (link.state, link.stream, link.carried, far.dialled) == (PeerLinkState.IDLE, None, 0, 0)
        ends = [await used(link, far) for _ in range(3)]
        for reader, writer, _ in ends:
            writer.write(b"ping")
            assert await reader.readexactly(4) == b"ping"
        assert (link.state, link.carried, far.dialled) == (PeerLinkState.LINKED, 3, 1)
        assert link.stream is not None
        for _, writer, carrying in ends:
            writer.close()
            await carrying
        assert link.carried == 0


@pytest.mark.parametrize(
    ("failure", "error"),
    [
        (TimeoutError(), "office does not answer"),
        (OSError("no route"), "no link to office: no route"),
        (HandshakeTimeout("late", "a plain node?"), "office does not answer"),
        (PeerUnreachable("nobody", "hint"), "nobody"),
    ],
    ids=["silent", "network", "inbox", "refused"],
)
async def test_a_failure_is_told_to_all_and_not_tried_again_at_once(failure: Exception, error: str) -> None:
    now = [0.0]
    async with linked(lambda: now[0]) as (link, far):
        far.failure = failure
        for _ in range(3):
            waiting = [(await used(link, far))[2] for _ in range(2)]
            for each in waiting:
                with pytest.raises(RelayRefused, match=error):
                    await each
        assert (far.dialled, link.state) == (1, PeerLinkState.FAILED)
        assert link.error == error
        assert link.hint
        now[0] += 0.5
        with pytest.raises(RelayRefused):
            await (await used(link, far))[2]
        assert far.dialled == 2
        far.failure = None
        now[0] += 5
        reader, writer, _ = await used(link, far)
        writer.write(b"x")
        assert await reader.readexactly(1) == b"x"
        assert (link.state, link.error, link.hint) == (PeerLinkState.LINKED, "", "")


async def test_the_connection_is_closed_when_there_is_no_link() -> None:
    async with linked() as (link, far):
        far.failure = TimeoutError()
        reader, _, carrying = await used(link, far)
        with pytest.raises(RelayRefused):
            await carrying
        assert await reader.read() == b""


async def test_a_link_that_breaks_is_made_anew_for_the_next_connection() -> None:
    async with linked() as (link, far):
        reader, writer, carrying = await used(link, far)
        writer.write(b"x")
        await reader.readexactly(1)
        far.links[0].abort("broken")
        await carrying
        await until(lambda: link.state is PeerLinkState.FAILED)
        assert link.stream is None
        reader, writer, _ = await used(link, far)
        writer.write(b"y")
        assert await reader.readexactly(1) == b"y"
        assert (far.dialled, link.error) == (2, "")


async def test_a_peer_that_refuses_after_the_handshake_is_not_dialled_at_once_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    now = [0.0]
    async with linked(lambda: now[0]) as (link, far):
        far.refuses = True
        for attempt in range(1, 5):
            reader, writer, carrying = await used(link, far)
            with contextlib.suppress(ConnectionResetError):
                assert await reader.read() == b""
            writer.close()
            with contextlib.suppress(RelayRefused):
                await carrying
            await until(lambda: link.state is PeerLinkState.FAILED)
            with pytest.raises(RelayRefused):
                await (await used(link, far))[2]
            assert far.dialled == attempt
            assert "there: rossec relay list" in link.hint
            now[0] += 5
        assert caplog.text.count("no link to office") == 1
        far.refuses = False
        reader, writer, _ = await used(link, far)
        writer.write(b"x")
        assert await reader.readexactly(1) == b"x"


async def test_a_link_that_is_not_used_is_closed_after_a_while() -> None:
    now = [0.0]
    async with linked(lambda: now[0]) as (link, far):
        reader, writer, carrying = await used(link, far)
        writer.write(b"x")
        await reader.readexactly(1)
        now[0] += asyncio.get_running_loop().time() + 2 * IDLE_FOR
        link.tick()
        await asyncio.sleep(0.05)
        assert link.state is PeerLinkState.LINKED  # it carries one
        writer.close()
        await carrying
        now[0] += asyncio.get_running_loop().time() + 2 * IDLE_FOR
        link.tick()
        await until(lambda: link.state is PeerLinkState.IDLE)
        assert link.error == ""
        link.tick()
