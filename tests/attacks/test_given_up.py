"""What a peer makes this side hold, before it is known and after it was refused."""

import asyncio
import gc
import socket
import sys
import tracemalloc
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, closing, contextmanager, suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Final

import pytest
from rosbags.rosbag1 import Writer

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol, first_bytes
from rossec.channel.records import Frame
from rossec.cli.policy import simulate
from rossec.errors import ChannelError, ConfigurationError, LimitExceeded
from rossec.net.aio import SecureContext, SecureServer, SecureStream, connect, serve
from rossec.net.aio import stream as secure_stream
from rossec.net.limits import ACCEPTED, BATCH_LIMIT, DIALLED
from rossec.net.rpc.calls import serve_calls
from rossec.participant.connections import Dialer
from rossec.ros.tcpros import MESSAGE_LIMIT
from tests.rossec.participant.test_dialer import Talker
from tests.support.contexts import context
from tests.support.secure_sockets import background, dial, make_listener
from tests.support.secure_streams import Stream, echo
from tests.support.site import Site
from tests.support.wire import ALICE, BOB, FakeIdentity
from tests.support.witness import until

CALLERS: Final = 20
MOST: Final = 1024  # bytes of buffer for one of them
LIMIT: Final = 2 * 1024 * 1024
LARGE: Final = 1024 * 1024
ROBOT, EVE, TOPIC, TYPE = "/robot", "/eve", "/eve/endless", "std_msgs/String"


@contextmanager
def without_collector() -> Iterator[None]:
    """What only the collector frees stays: it runs by the number of objects, not by their size."""
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


def large_ones() -> list[int]:
    """Sizes of the large buffers of units that something refers to, also in a cycle."""
    return [
        found
        for each in gc.get_objects()
        if type(each) is BytesIO and not each.closed and (found := sys.getsizeof(each)) > LARGE
    ]


@asynccontextmanager
async def strangers(server: SecureServer[FakeIdentity], announced: int) -> AsyncIterator[list[socket.socket]]:
    """Callers that send an opening, the header of a frame, and nothing more: 82 octets."""
    head = first_bytes(WireProtocol.HTTP) + (Frame.HANDSHAKE << 28 | announced).to_bytes(4)
    assert len(head) == 82
    callers = []
    try:
        for _ in range(CALLERS):
            caller = socket.create_connection(("127.0.0.1", server.port))
            callers.append(caller)
            caller.sendall(head)
        yield callers
    finally:
        for caller in callers:
            caller.close()


@pytest.mark.attack("half-open-memory")
async def test_82_octets_of_a_stranger_hold_no_more_than_they_need() -> None:
    async with serve(echo, "127.0.0.1", 0, context(BOB), WireProtocol.HTTP) as server:
        tracemalloc.start()
        try:
            async with strangers(server, 2240):
                await until(
                    lambda: sum(len(each.connection._buffer) for each in server._streams) == 4 * CALLERS
                )
                found = tracemalloc.take_snapshot()
                assert server.connections == CALLERS
        finally:
            tracemalloc.stop()
        buffers = found.filter_traces([tracemalloc.Filter(True, "*/channel/buffers.py")])
        assert sum(each.size for each in buffers.statistics("filename")) < CALLERS * MOST


@pytest.mark.attack("half-open-memory")
async def test_a_first_message_that_is_too_long_is_refused_by_its_header() -> None:
    async with (
        serve(echo, "127.0.0.1", 0, context(BOB), WireProtocol.HTTP) as server,
        strangers(server, 2241),
    ):
        await until(lambda: server.connections == 0)


@pytest.mark.attack("endless-unit-kept")
async def test_a_record_beyond_the_limit_is_refused_before_it_has_arrived() -> None:
    """Else its header alone makes room for two of the largest records."""
    own = replace(context(BOB), accept_limits=ACCEPTED)
    accepted: list[Stream] = []

    async def note(stream: Stream) -> None:
        accepted.append(stream)
        await stream.wait_ended()

    async with serve(note, "127.0.0.1", 0, own) as server:
        stream = await connect("127.0.0.1", server.port, context(ALICE))
        await until(lambda: bool(accepted))
        record = next(stream.connection.seal_unit(bytes(200 * 1024)))
        stream.transport.write(bytes(record[:4]))
        await until(lambda: accepted[0].error is not None)
        assert isinstance(accepted[0].error, LimitExceeded)
        stream.abort("done")


@pytest.mark.attack("endless-unit-kept")
def test_the_limit_of_the_specification_holds_for_every_connection() -> None:
    for limits in (ACCEPTED, DIALLED):
        assert limits[WireProtocol.TCPROS].unit == MESSAGE_LIMIT + BATCH_LIMIT


@pytest.mark.attack("endless-unit-kept")
async def test_an_endless_unit_is_dropped_at_its_limit_though_its_error_is_kept() -> None:
    kept: list[BaseException] = []

    async def endless(stream: Stream) -> None:
        await stream.send(bytes(3 * LIMIT))

    async with serve(endless, "127.0.0.1", 0, context(BOB)) as server:
        with without_collector():
            before = len(large_ones())
            for _ in range(5):
                stream = await connect("127.0.0.1", server.port, context(ALICE))
                stream.raise_unit_limit(LIMIT)
                with pytest.raises(LimitExceeded) as refusal:
                    await stream.receive()
                kept += [refusal.value, stream.error or refusal.value]
                assert stream.error is not None
                assert stream.error.__traceback__ is None
                stream.abort("seen")
            assert len(large_ones()) == before
    assert len(kept) == 10


@pytest.mark.attack("endless-unit-kept")
def test_an_endless_unit_is_dropped_at_its_limit_in_programs_with_threads() -> None:
    with closing(make_listener()) as listener, without_collector():
        before, kept = len(large_ones()), []

        def endless() -> None:
            sock, _ = listener.accept()
            with closing(sock), suppress(ChannelError, OSError):
                sock.sendall(bytes(3 * LIMIT))

        for _ in range(5):
            thread = background(endless)
            sock = dial(listener, context(ALICE))
            sock.raise_unit_limit(LIMIT)
            with pytest.raises(LimitExceeded) as refusal:
                sock.recv(1)
            kept.append((sock, refusal.value))
            sock.close()
            thread.join(30)
        assert len(large_ones()) == before
        errors = [sock._error for sock, _ in kept if sock._error is not None]
        assert [each.__traceback__ for each in errors] == [None] * 5


@pytest.mark.attack("endless-unit-kept")
async def test_a_subscriber_keeps_nothing_of_a_granted_publisher_of_endless_units(site: Site) -> None:
    site.publish(EVE, TOPIC)
    site.subscribe(ROBOT, TOPIC)
    async with site.node(EVE) as eve, site.node(ROBOT) as robot:
        publisher = await eve.publisher(TOPIC, TYPE)
        with without_collector():
            before = len(large_ones())
            subscriber = await robot.subscriber(TOPIC, TYPE)
            for _ in range(2):
                subscriber.refusals.clear()
                await publisher.wait_for_subscribers()
                (link,) = publisher.links
                await until(lambda: bool(subscriber.links))
                (received,) = subscriber.links
                received.stream.raise_unit_limit(LIMIT)
                with suppress(ChannelError):
                    await link.stream.send(bytes(3 * LIMIT))
                await until(lambda: bool(subscriber.refusals))
                del link, received
            assert isinstance(subscriber.refusals[0], LimitExceeded)
            assert subscriber.refusals[0].__traceback__ is None
            assert len(large_ones()) == before


@pytest.mark.attack("bag-bomb")
@pytest.mark.parametrize("form", list(Writer.CompressionFormat))
def test_a_bag_of_kilobytes_does_not_become_gigabytes(
    form: Writer.CompressionFormat, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(simulate, "MAX_CHUNK", LIMIT, raising=False)
    messages = {"bomb": bytes(16 * LIMIT), "bag": bytes(LARGE)}
    for name, message in messages.items():
        writer = Writer(tmp_path / name)
        writer.set_compression(form)
        with writer:
            topic = writer.add_connection(
                "/bomb", "std_msgs/msg/String", msgdef="string data\n", md5sum="0" * 32
            )
            writer.write(topic, 1, message)
    assert (tmp_path / "bomb").stat().st_size < LARGE
    assert [len(data) for *_, data in simulate._messages(tmp_path / "bag")] == [LARGE]
    tracemalloc.start()
    try:
        with pytest.raises(ConfigurationError, match="a chunk that is cut off, or has more than"):
            list(simulate._messages(tmp_path / "bomb"))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 4 * LIMIT


class OpenEnded(Talker):
    """Answers, reads nothing more, and so never ends its side of the connection."""

    async def serve_api(self, stream: SecureStream[Identity]) -> None:
        def dispatch(method: str, params: tuple[object, ...], peer: Identity) -> object:
            stream.transport.pause_reading()
            return self.dispatch(method, params, peer)

        await serve_calls(stream, dispatch)


@pytest.mark.attack("end-kept-open")
async def test_a_publisher_that_keeps_its_connection_open_is_subscribed_to(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The wait for its end took all of the time that a subscriber has for the handshake."""
    monkeypatch.setattr(secure_stream, "LINGER", 60.0)
    site = Site(tmp_path / "site")
    talker = OpenEnded(site, EVE)
    own = SecureContext(site.enroll(ROBOT).credentials(), site.anchor.verify)
    async with talker.topics, talker.api:
        async with asyncio.timeout(20):
            stream = await Dialer(ROBOT, own, lambda *_: None).topic(talker.uri, TOPIC)
        assert stream.peer.name == EVE
        stream.abort("seen")
