import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    JoinAnswer,
    NameAnswer,
    Named,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
)
from ca.errors import EnrollmentRefused, JoinBusy, JoinRefused, JoinWaiting
from rossec.enrollment import join
from rossec.enrollment.join import JoinServer
from rossec.errors import ConfigurationError, PeerUnreachable
from tests.support.joining import JoinSite, asked
from tests.support.pki import NOW

BUSY = RefusedMessage(RefuseReason.BUSY)


def clock() -> int:
    return NOW


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> JoinSite:
    monkeypatch.setattr(join, "RETRY_DELAY", 0.001)
    return JoinSite(tmp_path / "site")


class Answers:
    """Answers in this order; then what the authority decides."""

    def __init__(self, home: JoinSite, *first: JoinAnswer) -> None:
        self.home, self.first = home, list(first)
        self.requests: list[JoinRequest] = []

    async def __call__(self, request: JoinRequest) -> JoinAnswer:
        self.requests.append(request)
        return self.first.pop(0) if self.first else await self.home.admit(request)


async def test_a_node_joins(home: JoinSite) -> None:
    csr = asked("/fleet/a")
    domains: list[str] = []

    def request(domain: str) -> bytes:
        domains.append(domain)
        return csr

    async with home.serving():
        found = await join.join(home.invite(), request, clock)
    assert found.anchor.verify(found.chain, NOW).name == "/fleet/a"
    assert found.root == home.root
    assert domains == ["home"]


async def test_a_busy_authority_is_asked_again_with_the_same_request(home: JoinSite) -> None:
    csr, answers = asked("/fleet/a"), Answers(home, BUSY, BUSY)
    async with home.serving(JoinServer(home.identity, answers)):
        await join.join(home.invite(), lambda _: csr, clock)
    assert [request.csr for request in answers.requests] == [csr] * 3
    assert len({request.transcript for request in answers.requests}) == 3


async def test_an_authority_that_stays_busy(home: JoinSite) -> None:
    answers = Answers(home, *[BUSY] * 9)
    async with home.serving(JoinServer(home.identity, answers)):
        with pytest.raises(JoinBusy):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    assert len(answers.requests) == 5


@pytest.mark.parametrize(
    ("answer", "error"),
    [
        (RefusedMessage(RefuseReason.ENDED), JoinRefused),
        (WaitingMessage(WaitReason.LOCKED), JoinWaiting),
        (WaitingMessage(WaitReason.PERSON), JoinWaiting),
    ],
)
async def test_an_answer_is_not_asked_for_again(
    home: JoinSite, answer: JoinAnswer, error: type[Exception]
) -> None:
    answers = Answers(home, answer)
    async with home.serving(JoinServer(home.identity, answers)):
        with pytest.raises(error):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    assert len(answers.requests) == 1


@asynccontextmanager
async def closing(home: JoinSite, times: int) -> AsyncIterator[list[int]]:
    """A port before the authority's that closes so many connections at once."""
    closed: list[int] = []

    async def call(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if len(closed) < times:
            closed.append(1)
            writer.close()
            return
        there, back = await asyncio.open_connection("127.0.0.1", port)
        await asyncio.gather(carry(reader, back), carry(there, writer))

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(4096):
            writer.write(data)
        writer.close()

    async with home.serving() as serving:
        port = serving.port
        server = await asyncio.start_server(call, "127.0.0.1", 0)
        async with server:
            home.address = f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
            yield closed


async def test_a_connection_that_breaks_is_made_again(home: JoinSite) -> None:
    async with closing(home, 2) as closed:
        await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    assert len(closed) == 2


async def test_a_peer_that_always_closes(home: JoinSite) -> None:
    async with closing(home, 99) as closed:
        with pytest.raises(PeerUnreachable, match="no authority answers"):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    assert len(closed) == 5


async def test_nobody_listens(home: JoinSite) -> None:
    async with home.serving():
        code = home.invite()
    with pytest.raises(PeerUnreachable) as caught:
        await join.join(code, lambda _: asked("/fleet/a"), clock)
    assert "rossec ca serve" in caught.value.hint


async def test_a_silent_peer(home: JoinSite, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(join, "CONNECT_PATIENCE", 0.02)

    left, tries = asyncio.Event(), []

    async def silent(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read()
        writer.close()
        await writer.wait_closed()
        tries.append(1)
        if len(tries) == 5:
            left.set()

    server = await asyncio.start_server(silent, "127.0.0.1", 0)
    async with server:
        home.address = f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
        with pytest.raises(PeerUnreachable):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
        async with asyncio.timeout(20):
            await left.wait()


async def test_another_authority_at_the_address(home: JoinSite, tmp_path: Path) -> None:
    other = JoinSite(tmp_path / "other")
    async with other.serving():
        home.address = other.address
        with pytest.raises(EnrollmentRefused, match="another authority"):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)


def with_address(code: InvitationCode, address: str) -> InvitationCode:
    return replace(code, address=address)


async def test_an_address_that_is_none(home: JoinSite) -> None:
    with pytest.raises(ConfigurationError):
        await join.join(with_address(home.invite(), "no:port:"), lambda _: b"", clock)


async def test_a_name_is_asked_for_and_the_request_has_the_metadata(home: JoinSite) -> None:
    metadata, claims, answers = b"<node/>", list[JoinClaim](), Answers(home)

    async def named(claim: JoinClaim) -> NameAnswer:
        claims.append(claim)
        return BUSY if len(claims) == 1 else Named("/fleet/a")

    async with home.serving(JoinServer(home.identity, answers, name=named)):
        code = home.invite()
        assert await join.ask_name(code, metadata, clock) == "/fleet/a"
        found = await join.join(code, lambda _: asked("/fleet/a"), clock, metadata)
    assert found.anchor.verify(found.chain, NOW).name == "/fleet/a"
    assert [claim.metadata for claim in claims] == [metadata, metadata]
    assert answers.requests[0].metadata == metadata


async def test_an_authority_that_gives_no_names(home: JoinSite) -> None:
    async with home.serving():
        with pytest.raises(JoinRefused, match="too old to give names"):
            await join.ask_name(home.invite(), b"<node/>", clock)
    with pytest.raises(PeerUnreachable):
        await join.ask_name(home.invite(), b"<node/>", clock)
