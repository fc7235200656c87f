import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

import pytest

from ca.enrollment import qr
from ca.enrollment.messages import Abort, Fetch, Message, Reason, frame, read, write
from ca.enrollment.sides import AuthorityEnrollment, AuthorityState, NodeEnrollment, NodeState, Pending
from ca.errors import ConflictingOffer, EnrollmentExpired, EnrollmentOver, EnrollmentRefused
from rossec.enrollment import sessions
from rossec.enrollment.enroll import WaitingNode
from tests.support import refusal_texts
from tests.support.enrolling import WINDOW, Robot, fresh
from tests.support.pki import NOW, Site

SITE, OTHER = Site.create(), Site.create()


class Clock:
    """Time stands still unless a test says otherwise."""

    now = NOW

    def __call__(self) -> int:
        return self.now


class Caller:
    """A caller that has connected."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer

    async def read_until(self) -> Message:
        async with asyncio.timeout(20):
            return read(await sessions.receive(self.reader))

    async def is_left(self) -> bool:
        with suppress(ConnectionResetError):
            async with asyncio.timeout(20):
                return await self.reader.read(1) == b""
        return True

    def says(self, message: bytes) -> None:
        sessions.send(self.writer, message)

    async def answers(self, core: AuthorityEnrollment) -> None:
        async with asyncio.timeout(20):
            core.receive(await sessions.receive(self.reader), NOW)


class Stage:
    """A waiting node, and callers."""

    def __init__(self, core: NodeEnrollment, patience: float) -> None:
        self.core, self.clock = core, Clock()
        self.refused: list[str] = []
        self.node = WaitingNode(core, self.clock, self.refused.append, patience)
        self.host = "127.0.0.1"
        self.trusted: list[Pending] = []
        self.callers: list[Caller] = []

    async def caller(self) -> Caller:
        caller = Caller(*await asyncio.open_connection(self.host, self.node.port))
        self.callers.append(caller)
        return caller

    async def empty(self) -> None:
        """Everybody goes home."""
        for caller in self.callers:
            caller.writer.transport.abort()
        for caller in self.callers:
            with suppress(OSError):
                await caller.writer.wait_closed()

    async def offered(self, site: Site = SITE) -> tuple[AuthorityEnrollment, bytes, Caller]:
        code = qr.parse(self.core.code(f"{self.host}:{self.node.port}"))
        authority, caller = AuthorityEnrollment(code, "home"), await self.caller()
        caller.says(authority.fetch())
        await caller.answers(authority)
        authority.approve(NOW)
        leaf = site.authority.issue(authority.csr, now=NOW, serial=7)
        offer = authority.offer([leaf], site.root, fresh(), NOW)
        caller.says(offer)
        return authority, offer, caller

    async def ends(self, *states: NodeState) -> None:
        async with asyncio.timeout(20):
            await self.node.until(*states, every=lambda _: None)


@asynccontextmanager
async def waiting(
    *, label: bool = False, host: str = "127.0.0.1", patience: float = 20
) -> AsyncIterator[Stage]:
    stage = Stage(Robot().enrollment(label=label), patience)
    stage.host = host
    async with stage.node:
        await stage.node.listen(host, 0)
        try:
            yield stage
        finally:
            stage.node.stop(EnrollmentOver("the test is over"))
    await stage.empty()


@pytest.mark.parametrize("host", ["127.0.0.1", "::1"])
@pytest.mark.parametrize("label", [False, True])
async def test_an_enrollment(host: str, label: bool) -> None:
    async with waiting(label=label, host=host) as stage:
        authority, _, caller = await stage.offered()
        await stage.ends(NodeState.PENDING)
        await caller.answers(authority)
        stage.node.confirm(authority.digits, stage.trusted.append)
        await caller.answers(authority)
        await stage.ends(NodeState.ENROLLED)
    assert authority.state is AuthorityState.ENROLLED
    assert [pending.root for pending in stage.trusted] == [SITE.root]
    assert stage.refused == []


async def test_an_answer_that_was_lost_comes_again() -> None:
    async with waiting() as stage:
        authority, offer, first = await stage.offered()
        await stage.ends(NodeState.PENDING)
        first.writer.transport.abort()
        second = await stage.caller()
        second.says(offer)
        await second.answers(authority)
        stage.node.confirm(authority.digits, stage.trusted.append)
        await second.answers(authority)
        third = await stage.caller()
        third.says(offer)
        await third.answers(authority)
        await third.answers(authority)
    assert authority.state is AuthorityState.ENROLLED


async def test_a_conflicting_offer_ends_both_enrollments() -> None:
    async with waiting() as stage:
        _, _, first = await stage.offered()
        await first.read_until()
        _, _, second = await stage.offered(OTHER)
        assert await first.read_until() == Abort(Reason.CONFLICT)
        assert await second.read_until() == Abort(Reason.CONFLICT)
        with pytest.raises(ConflictingOffer):
            await stage.ends(NodeState.ENROLLED)
        assert await second.is_left()
    assert "127.0.0.1: this node received two different offers" in stage.refused[0]


async def test_offers_without_the_secret_lock_the_code() -> None:
    async with waiting() as stage:
        stage.core._secret, secret = bytes(16), stage.core._secret
        offers = []
        for _ in range(5):
            authority = AuthorityEnrollment(qr.parse(stage.core.code("x")), "home")
            (delivery,) = stage.core.receive(authority.fetch(), NOW)
            authority.receive(delivery, NOW)
            authority.approve(NOW)
            leaf = SITE.authority.issue(authority.csr, now=NOW, serial=7)
            offers.append(authority.offer([leaf], SITE.root, fresh(), NOW))
        stage.core._secret = secret
        reasons = []
        for offer in offers:
            caller = await stage.caller()
            caller.says(offer)
            answer = await caller.read_until()
            assert isinstance(answer, Abort)
            reasons.append(answer.reason)
        assert reasons == [Reason.REFUSED] * 4 + [Reason.OVER]
        with pytest.raises(EnrollmentOver, match="5 offers without the code's secret"):
            await stage.ends(NodeState.PENDING)
    assert len(stage.refused) == 5


async def test_garbage_ends_its_connection_only() -> None:
    async with waiting() as stage:
        for garbage in (b"GET / HTTP/1.1\r\n\r\n", frame(b"\xff"), frame(write(Abort(Reason.OVER)))):
            stranger = await stage.caller()
            stranger.writer.write(garbage)
            assert await stranger.read_until() == Abort(Reason.REFUSED)
            assert await stranger.is_left()
        quitter = await stage.caller()
        quitter.writer.write(b"\0\0")
        quitter.writer.close()
        await stage.offered()
        await stage.ends(NodeState.PENDING)
    assert len(stage.refused) == 3


async def test_a_silent_caller_is_not_waited_for() -> None:
    async with waiting(patience=0.05) as stage:
        silent = await stage.caller()
        assert await silent.is_left()


async def test_an_answered_caller_stays_connected() -> None:
    async with waiting() as stage:
        _, offer, answered = await stage.offered()
        first = await answered.read_until()
        stage.node._patience = 0.05
        answered.says(offer)
        assert await answered.read_until() == first
        await asyncio.sleep(0.2)  # longer than the patience with strangers
        stage.node.stop(EnrollmentOver("enough"))
        assert await answered.read_until() == Abort(Reason.OVER)


async def test_few_callers_at_a_time() -> None:
    async with waiting() as stage:
        callers = [await stage.caller() for _ in range(4)]
        for caller in callers:
            caller.says(write(Fetch()))
            await caller.read_until()
        fifth = await stage.caller()
        assert await fifth.is_left()
        callers[0].writer.close()
        await callers[0].writer.wait_closed()
        while True:  # until the node has noticed
            sixth = await stage.caller()
            sixth.says(write(Fetch()))
            with suppress(EOFError, ConnectionError):
                await sixth.read_until()
                break


async def test_time_is_over() -> None:
    async with waiting() as stage:
        left: list[int] = []

        def every(seconds: int) -> None:
            left.append(seconds)
            stage.clock.now += WINDOW + 1

        with pytest.raises(EnrollmentExpired):
            await stage.node.until(NodeState.PENDING, every=every)
    assert left == [WINDOW]


async def test_an_identity_that_cannot_be_written_is_not_trusted() -> None:
    async with waiting() as stage:
        authority, _, caller = await stage.offered()
        await caller.answers(authority)

        def full(_: Pending) -> None:
            raise OSError("no space left on device")

        with pytest.raises(EnrollmentRefused, match=refusal_texts.DIGITS_REFUSED):
            stage.node.confirm("no", full)
        with pytest.raises(OSError, match="no space"):
            stage.node.confirm(authority.digits, full)
        assert await caller.read_until() == Abort(Reason.OVER)
        with pytest.raises(EnrollmentOver, match="could not be written: no space"):
            await stage.ends(NodeState.ENROLLED)


async def test_a_caller_that_does_not_read_is_disconnected() -> None:
    async with waiting(patience=0.5) as stage:
        caller = await stage.caller()
        caller.writer.transport.pause_reading()  # type: ignore[attr-defined]
        many = frame(write(Fetch())) * 1000
        with suppress(ConnectionError):
            async with asyncio.timeout(60):
                while True:
                    caller.writer.write(many)
                    await caller.writer.drain()
        assert stage.core.state is NodeState.SHOWING
