import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from pathlib import Path

import pytest

from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    Hello,
    Issued,
    JoinAnswer,
    JoinMessage,
    NameAnswer,
    Named,
    NodeJoin,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    Welcome,
    read,
    write,
)
from ca.enrollment.messages import frame
from ca.errors import RecordUnusable
from rossec.enrollment import sessions
from rossec.enrollment.join import MAX_OF_INVITATION, Admit, JoinServer
from rossec.net.limits import HalfOpenLimits
from tests.support.joining import JoinSite, asked, fresh, issued
from tests.support.pki import NOW

LOCKED = WaitingMessage(WaitReason.LOCKED)


class Peer:
    """A connection to the port."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def next(self) -> JoinMessage:
        async with asyncio.timeout(20):
            return read(await sessions.receive(self.reader))

    async def is_closed(self) -> bool:
        with suppress(ConnectionResetError):
            async with asyncio.timeout(20):
                return await self.reader.read() == b""
        return True

    def says(self, message: bytes) -> None:
        sessions.send(self.writer, message)

    async def proves(self, code: InvitationCode, csr: bytes) -> None:
        """Up to the request, whose answer is not read."""
        core = NodeJoin(code, fresh())
        self.says(core.hello())
        async with asyncio.timeout(20):
            core.receive(await sessions.receive(self.reader), NOW)
        self.says(core.join(csr))


@pytest.fixture
def home(tmp_path: Path) -> JoinSite:
    return JoinSite(tmp_path / "site")


@asynccontextmanager
async def connected(server: JoinServer) -> AsyncIterator[Peer]:
    reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
    try:
        yield Peer(reader, writer)
    finally:
        writer.close()


async def test_a_session(home: JoinSite) -> None:
    code = home.invite()
    async with home.serving() as server, connected(server) as peer:
        await peer.proves(code, asked("/fleet/a"))
        answer = await peer.next()
        assert isinstance(answer, Issued)
        assert issued(answer) == home.store.identities.by_name("/fleet/a")[0].der
        assert await peer.is_closed()


@pytest.mark.parametrize(
    "data",
    [
        frame(b"rubbish"),
        (1 << 20).to_bytes(4),
        frame(write(LOCKED)),
        frame(write(Welcome(bytes(16), (b"c",), b"r", b"s"))),
    ],
)
async def test_a_broken_session_is_told_nothing_and_reported(home: JoinSite, data: bytes) -> None:
    reported: list[str] = []
    server = JoinServer(home.identity, home.admit, reported.append)
    async with home.serving(server), connected(server) as peer:
        peer.writer.write(data)
        assert await peer.next() == RefusedMessage(RefuseReason.REFUSED)
        assert await peer.is_closed()
    [line] = reported
    assert line.startswith("127.0.0.1: ")


async def test_a_second_hello_ends_the_session(home: JoinSite) -> None:
    async with home.serving() as server, connected(server) as peer:
        for _ in range(2):
            peer.says(write(Hello(bytes(32), fresh())))
        assert isinstance(await peer.next(), Welcome)
        assert await peer.next() == RefusedMessage(RefuseReason.REFUSED)


async def test_a_peer_that_is_silent_is_closed(home: JoinSite) -> None:
    server = JoinServer(home.identity, home.admit, patience=0.05)
    async with home.serving(server), connected(server) as peer:
        assert await peer.is_closed()
    server = JoinServer(home.identity, home.admit, patience=0.3)
    async with home.serving(server), connected(server) as peer:
        peer.says(write(Hello(bytes(32), fresh())))
        assert isinstance(await peer.next(), Welcome)
        assert await peer.is_closed()


async def test_a_peer_that_leaves_is_no_trouble(home: JoinSite) -> None:
    async with home.serving() as server:
        async with connected(server) as peer:
            peer.writer.write(b"\0\0")
        code = home.invite()
        async with connected(server) as peer:
            await peer.proves(code, asked("/fleet/a"))
            assert isinstance(await peer.next(), Issued)


async def test_the_open_sessions_of_an_address_are_bounded(home: JoinSite) -> None:
    server = JoinServer(home.identity, home.admit, caps=HalfOpenLimits(per_address=1, total=9))
    async with home.serving(server), connected(server) as first:
        first.says(write(Hello(bytes(32), fresh())))
        assert isinstance(await first.next(), Welcome)
        async with connected(server) as second:
            assert await second.is_closed()
        first.says(write(LOCKED))
        assert await first.next() == RefusedMessage(RefuseReason.REFUSED)


class Gate:
    """Decides only when it is opened; counts what it is deciding."""

    def __init__(self) -> None:
        self.opened, self.count, self.most = asyncio.Event(), 0, 0
        self.reached, self.passed = asyncio.Event(), asyncio.Event()

    async def admit(self, _: JoinRequest) -> JoinAnswer:
        self.count += 1
        self.most = max(self.most, self.count)
        if self.count == MAX_OF_INVITATION:
            self.reached.set()
        if self.count > MAX_OF_INVITATION:
            self.passed.set()
        await self.opened.wait()
        self.count -= 1
        return LOCKED


async def test_the_decisions_of_one_invitation_are_bounded_and_the_others_wait(home: JoinSite) -> None:
    gate, code = Gate(), home.invite(uses=99)

    async def ask(server: JoinServer, by: InvitationCode) -> JoinMessage:
        async with connected(server) as peer:
            await peer.proves(by, asked("/fleet/a"))
            return await peer.next()

    server = JoinServer(home.identity, gate.admit)
    async with home.serving(server), asyncio.TaskGroup() as group:
        tasks = [group.create_task(ask(server, code)) for _ in range(3 * MAX_OF_INVITATION)]
        async with asyncio.timeout(20):
            await gate.reached.wait()
        await asyncio.sleep(0.1)
        assert gate.most == MAX_OF_INVITATION
        other = group.create_task(ask(server, home.invite()))
        async with asyncio.timeout(20):
            await gate.passed.wait()
        gate.opened.set()
    assert [task.result() for task in (*tasks, other)] == [LOCKED] * (len(tasks) + 1)


async def test_a_decision_that_takes_too_long(home: JoinSite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("rossec.enrollment.join.DECISION", 0.05)
    server = JoinServer(home.identity, Gate().admit)
    async with home.serving(server), connected(server) as peer:
        await peer.proves(home.invite(), asked("/fleet/a"))
        assert await peer.next() == RefusedMessage(RefuseReason.BUSY)


async def failing(_: JoinRequest) -> JoinAnswer:
    raise RecordUnusable("the disk is full")


async def crashing(_: JoinRequest) -> JoinAnswer:
    raise ZeroDivisionError


@pytest.mark.parametrize("admit", [failing, crashing])
async def test_a_request_that_cannot_be_decided(
    home: JoinSite, admit: Admit, caplog: pytest.LogCaptureFixture
) -> None:
    server = JoinServer(home.identity, admit)
    async with home.serving(server), connected(server) as peer:
        await peer.proves(home.invite(), asked("/fleet/a"))
        if admit is failing:
            assert await peer.next() == RefusedMessage(RefuseReason.BUSY)
        assert await peer.is_closed()
    assert [record.levelname for record in caplog.records] == ["ERROR"]


async def test_close_ends_open_sessions(home: JoinSite) -> None:
    async with home.serving() as server, connected(server) as peer:
        peer.says(write(Hello(bytes(32), fresh())))
        assert isinstance(await peer.next(), Welcome)
        await server.close()
        assert await peer.is_closed()


NODE = b"<node/>"


async def named_a(claim: JoinClaim) -> NameAnswer:
    return Named("/fleet/a") if claim.metadata == NODE else RefusedMessage(RefuseReason.METADATA)


async def claimed(peer: Peer, code: InvitationCode, metadata: bytes = NODE) -> NodeJoin:
    core = NodeJoin(code, fresh())
    peer.says(core.hello())
    async with asyncio.timeout(20):
        core.receive(await sessions.receive(peer.reader), NOW)
    peer.says(core.claim(metadata))
    return core


async def test_a_node_is_named_and_joins_in_one_session(home: JoinSite) -> None:
    server = JoinServer(home.identity, home.admit, name=named_a)
    async with home.serving(server), connected(server) as peer:
        code = home.invite()
        core = await claimed(peer, code)
        core.receive(write(await peer.next()), NOW)
        peer.says(core.join(asked(core.name)))
        core.receive(write(await peer.next()), NOW)
        assert core.identity.chain
        assert await peer.is_closed()


async def test_a_refused_claim_ends_the_session(home: JoinSite) -> None:
    server = JoinServer(home.identity, home.admit, name=named_a)
    async with home.serving(server), connected(server) as peer:
        await claimed(peer, home.invite(), b"<other/>")
        assert await peer.next() == RefusedMessage(RefuseReason.METADATA)
        assert await peer.is_closed()


async def test_who_gives_no_names_answers_as_one_of_an_earlier_version(home: JoinSite) -> None:
    async with home.serving() as server, connected(server) as peer:
        await claimed(peer, home.invite())
        assert await peer.next() == RefusedMessage(RefuseReason.REFUSED)


async def test_a_claim_that_cannot_be_decided(home: JoinSite) -> None:
    async def broken(_: JoinClaim) -> NameAnswer:
        raise RecordUnusable("the disk is full")

    server = JoinServer(home.identity, home.admit, name=broken)
    async with home.serving(server), connected(server) as peer:
        await claimed(peer, home.invite())
        assert await peer.next() == RefusedMessage(RefuseReason.BUSY)
