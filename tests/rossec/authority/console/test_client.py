"""The console's side of the socket: every operation typed, and a service that was restarted."""

import asyncio
import contextlib
import os
from collections.abc import AsyncIterator, Iterator
from pathlib import Path

import pytest

from grants.document import peek, read_scope
from rossec.authority.console import messages as views
from rossec.authority.console.client import ConsoleClient
from rossec.authority.console.messages import PasskeyAssertion, PasskeyRegistration
from rossec.errors import AuthorityLocked, KeyMessageRefused, KeyServiceFailed, PeerUserRefused
from tests.support.consoleservice import FakeHome, fake_service

ASSERTION = PasskeyAssertion(b"\5" * 32, b"{}", b"data", b"signature")


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "console.sock"


@pytest.fixture
def home(path: Path) -> Iterator[FakeHome]:
    with fake_service(path) as home:
        yield home


@pytest.fixture
async def client(path: Path) -> AsyncIterator[ConsoleClient]:
    client = ConsoleClient(path)
    yield client
    await client.close()


async def test_what_is_read_comes_as_views(home: FakeHome, client: ConsoleClient) -> None:
    status = await client.status()
    assert (status.domain, status.locked, status.remaining) == ("home", False, 600)
    assert [node.name for node in await client.nodes()] == ["/robot", "/doctor", "/heating", "/map"]
    grants = await client.grants()
    assert [peek(grant.data).subject for grant in grants] == ["/robot", "/doctor", "/heating"]
    assert [each.name for each in await client.identity_requests()] == ["/lamp"]
    (question,) = await client.questions()
    (right,) = await client.consider(question.id, "coarse", 0)
    (permission,) = read_scope(right.permissions)
    assert permission.restriction is not None
    assert (await client.invitations())[0].names == ("/lamp/1",)
    assert (await client.phones())[0].name == "Anna's phone"
    assert (await client.proposals())[0].digits == "123456"
    assert len(await client.approvals(1)) == 1
    assert [event.number for event in await client.events(0, 3)] == [39, 38, 37]
    assert [event.number for event in await client.events(37, 1)] == [36]
    assert (await client.denials())[0].name == "/robot/scan"
    assert len(await client.graph()) == 3
    assert (await client.policy()).gives[0].node == "/map"
    assert (await client.trust_status(1, 4)).nodes_with_list == 3


async def test_what_only_takes_away(home: FakeHome, client: ConsoleClient) -> None:
    number = (await client.status()).number
    grant = home.grants[1].id
    assert await client.revoke_grant(grant, "moved out") == (1, number + 1)
    assert (await client.grants())[1].reason == "moved out"
    home.remaining = None
    assert await client.revoke_node("/heating", "sold") == (0, 0)
    await client.deny_request(home.requests[0].id, "who?")
    await client.deny_question(home.questions[0].id, "no")
    await client.end_invitation(home.invitations[0].id, "enough")
    await client.remove_phone(home.phones[0].id, "lost")
    assert (await client.identity_requests(), await client.questions()) == ((), ())
    assert (await client.invitations())[0].state == "ended: enough"
    assert (await client.status()).phones == 0


async def test_what_a_passkey_approves(home: FakeHome, client: ConsoleClient) -> None:
    prepared = await client.prepare("grant", [home.questions[0].id, "", 0])
    assert prepared.credentials == (home.phones[0].id,)
    outcome = await client.approve(prepared.id, ASSERTION)
    assert (outcome.state, await client.outcome(prepared.id)) == ("done", outcome)
    assert await client.questions() == ()


async def test_who_looks(home: FakeHome, client: ConsoleClient) -> None:
    challenge = await client.login_challenge("http://localhost:7411")
    assert challenge.credentials == (home.phones[0].id,)
    assert await client.login(challenge.id, ASSERTION) == "Anna's phone"
    await client.redeem(home.add_code())
    challenge = await client.new_passkey("http://localhost:7411", "localhost")
    new = PasskeyRegistration(challenge.id, home.add_code(), "Ben's phone", b"{}", b"o")
    assert isinstance(await client.add_passkey(new), views.PhoneView)
    proposal = await client.propose_passkey(new._replace(code=await client.phone_link()))
    assert proposal in await client.proposals()


async def test_a_refusal_is_raised_as_what_it_is(home: FakeHome, client: ConsoleClient) -> None:
    home.refusals["deny-request"] = AuthorityLocked("the authority is locked", "unlock it")
    with pytest.raises(AuthorityLocked, match="is locked") as caught:
        await client.deny_request(b"", "")
    assert caught.value.hint == "unlock it"
    with pytest.raises(KeyMessageRefused):
        await client.prepare("grant", ["another type"])


async def test_a_restarted_service_is_asked_again(path: Path, client: ConsoleClient) -> None:
    with pytest.raises(KeyServiceFailed, match="does not run"):
        await client.status()
    for _ in range(2):
        with fake_service(path):
            statuses = await asyncio.gather(*(client.status() for _ in range(20)))
            assert len(statuses) == 20
    with pytest.raises(KeyServiceFailed, match="does not run"):
        await client.status()


async def test_one_who_gives_up_spoils_no_answer(home: FakeHome, client: ConsoleClient) -> None:
    for number in range(10):
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(number / 5000):
                await client.nodes()
        assert (await client.status()).domain == "home"


async def test_a_service_that_hangs_is_given_up(path: Path) -> None:
    async def hang(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while await reader.read(100):
            pass
        writer.close()

    async with await asyncio.start_unix_server(hang, path):
        with pytest.raises(KeyServiceFailed, match="does not answer"):
            await ConsoleClient(path, timeout=0.05).status()
        await asyncio.sleep(0.05)


@pytest.mark.parametrize(
    "answer", [b"\xff\xff\xff\xff", b"\0\0\0\0", b"\0\0\0\2\x82\0", b"\0\0\0\3\x82\0\7", b"\0\0\0\1\xff"]
)
async def test_an_answer_that_makes_no_sense_is_refused(path: Path, answer: bytes) -> None:
    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await reader.read(100)
        writer.write(answer)
        await writer.drain()
        writer.close()

    async with await asyncio.start_unix_server(serve, path):
        client = ConsoleClient(path)
        with pytest.raises((KeyMessageRefused, KeyServiceFailed)):
            await client.status()
        with pytest.raises((KeyMessageRefused, KeyServiceFailed)):
            await client.revoke_grant(b"", "")
        await client.close()


async def test_another_user_at_the_socket_is_refused(
    home: FakeHome, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    allowed: list[set[int]] = []

    def refuse(_: object, users: set[int]) -> int:
        allowed.append(users)
        raise PeerUserRefused("user 7 may not use this connection")

    monkeypatch.setattr("rossec.host.local_sockets.require_user", refuse)
    monkeypatch.setattr(os, "geteuid", lambda: 4711)
    for mode in (0o755, 0o777):
        path.parent.chmod(mode)
        with pytest.raises(KeyServiceFailed, match="another user listens"):
            await ConsoleClient(path).status()
    assert allowed == [{4711, path.parent.stat().st_uid}, {4711}]
