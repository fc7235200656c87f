"""Handshakes over loopback: refusals, certificates by hash, policies, expiry."""

import asyncio
import dataclasses

import pytest

from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.channel.edhoc.handshake import Initiator
from rossec.channel.edhoc.suites import POST_QUANTUM
from rossec.channel.records import ChannelLimits
from rossec.errors import (
    ConnectionTruncated,
    HandshakeFailed,
    IdentityRefused,
    LimitExceeded,
    PeerRefused,
    PlainPeer,
)
from rossec.net.aio import SecureServer, connect, serve
from rossec.net.aio.transport import Transport
from tests.support.contexts import context
from tests.support.secure_streams import Stream, call, echo, still_works
from tests.support.wire import ALICE, BOB, STRANGER, FakeIdentity, trust


async def test_data_sent_at_once_leaves_with_the_last_flight(monkeypatch: pytest.MonkeyPatch) -> None:
    written: dict[Transport, list[bool]] = {}
    write = Transport.write

    def note(self: Transport, data: bytes) -> None:
        written.setdefault(self, []).append(len(data) > 1000)
        write(self, data)

    monkeypatch.setattr(Transport, "write", note)
    async with serve(echo, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        await stream.send(b"x" * 1000)
        assert await stream.receive() == b"x" * 1000
        stream.abort("done")
    assert list(written.values()) == [[False, True], [False, True]]


async def test_a_peer_that_sends_nothing_finishes_the_handshake() -> None:
    async with serve(greet, "127.0.0.1", 0, context(BOB)) as server:
        stream = await call(server)
        assert await stream.receive() == b"welcome"
        stream.abort("done")


async def greet(stream: Stream) -> None:
    await stream.send(b"welcome")
    await stream.wait_ended()


async def test_a_stranger_is_refused_on_either_side(server: SecureServer[FakeIdentity]) -> None:
    stream = await connect("127.0.0.1", server.port, context(STRANGER))
    with pytest.raises(PeerRefused):
        await stream.receive()
    async with serve(echo, "127.0.0.1", 0, context(STRANGER)) as false:
        with pytest.raises(IdentityRefused):
            await call(false)
    await still_works(server)


async def test_an_expiring_certificate_ends_the_connection() -> None:
    def short(chain: tuple[bytes, ...], now: int) -> FakeIdentity:
        found = trust(chain, now)
        return FakeIdentity(found.name, found.public_key, found.certificate, now + 1)

    async with serve(echo, "127.0.0.1", 0, context(BOB, short)) as server:
        stream = await connect("127.0.0.1", server.port, context(ALICE, short))
        with pytest.raises((LimitExceeded, ConnectionTruncated)):
            await stream.receive()


async def test_calling_a_plain_server() -> None:
    async def plain(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(100)
        writer.write(b"\x10\0\0\0\x0c\0\0\0error=go off")
        writer.close()

    async with await asyncio.start_server(plain, "127.0.0.1", 0) as server:
        port = server.sockets[0].getsockname()[1]
        with pytest.raises(PlainPeer, match="go off"):
            await connect("127.0.0.1", port, context(ALICE))


async def test_the_second_connection_names_certificates(monkeypatch: pytest.MonkeyPatch) -> None:
    named, forget = list[bool](), Initiator.forget

    def noted(edhoc: Initiator[FakeIdentity]) -> None:
        named.append(edhoc.send_x5t)
        forget(edhoc)

    monkeypatch.setattr(Initiator, "forget", noted)
    ours, theirs = KnownCertificates(), KnownCertificates()
    async with serve(echo, "127.0.0.1", 0, context(BOB, known=theirs)) as server:
        for count in range(2):
            stream = await connect("127.0.0.1", server.port, context(ALICE, known=ours))
            await stream.send(b"x")
            assert await stream.receive() == b"x"
            await stream.close()
            assert named == [count == 1]  # message_3, by the initiator's
            named.clear()
        theirs._chains.clear()  # forgotten: refused with error 3, called again by value
        async with await connect("127.0.0.1", server.port, context(ALICE, known=ours)) as stream:
            await stream.send(b"x")
            assert await stream.receive() == b"x"


async def test_a_handshake_that_fails_by_hash_is_retried_by_value() -> None:
    ours, theirs = KnownCertificates(), KnownCertificates()
    async with serve(echo, "127.0.0.1", 0, context(BOB, known=theirs)) as server:
        for _ in range(3):
            stream = await connect("127.0.0.1", server.port, context(ALICE, known=ours))
            await stream.send(b"x")
            assert await stream.receive() == b"x"
            await stream.close()
            theirs._chains.update(dict.fromkeys(theirs._chains, STRANGER.chain))
        thief = dataclasses.replace(ALICE, signer=STRANGER.signer)
        stream = await connect("127.0.0.1", server.port, context(thief, known=ours))
        with pytest.raises(PeerRefused):  # by value as well
            await stream.receive()


async def test_the_hybrid_suite_by_policy() -> None:
    suites = POST_QUANTUM["require"]
    async with serve(echo, "127.0.0.1", 0, context(BOB, suites=suites)) as server:
        stream = await connect("127.0.0.1", server.port, context(ALICE, suites=suites))
        await stream.send(b"x")
        assert await stream.receive() == b"x"
        await stream.close()
        with pytest.raises(HandshakeFailed):
            await call(server)


async def test_keys_are_renewed_by_the_clock() -> None:
    limits = ChannelLimits(seconds=1)
    async with serve(echo, "127.0.0.1", 0, context(BOB, limits=limits)) as server:
        stream = await connect("127.0.0.1", server.port, context(ALICE, limits=limits))
        for _ in range(2):
            await stream.send(b"x")
            assert await stream.receive() == b"x"
            await asyncio.sleep(1.2)
        assert stream.connection._open_session().receive_epoch >= 1
        await stream.close()
