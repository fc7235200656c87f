"""Mallory and invitations: she guesses, replays, relays, floods, and plays the authority.

In turn she owns the network, is an enrolled node, or has a code that was stolen.
"""

import asyncio
import secrets
import threading
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, closing, suppress
from dataclasses import replace
from pathlib import Path

import pytest

from ca.enrollment.invitation import JoinRequest
from ca.enrollment.join import (
    Issued,
    Join,
    JoinAnswer,
    JoinMessage,
    LiveIdentity,
    NodeJoin,
    RefusedMessage,
    RefuseReason,
    WaitingMessage,
    WaitReason,
    read,
    write,
)
from ca.enrollment.messages import frame, length
from ca.errors import EnrollmentRefused, JoinRefused
from ca.store.record import Store
from rossec.authority import invitations
from rossec.authority.signing import SigningAuthority
from rossec.enrollment import join, sessions
from rossec.enrollment.join import JoinServer
from tests.support import refusal_texts
from tests.support.joining import HOUR, JoinSite, asked, fresh, issued, refusal
from tests.support.pki import NOW, new_signer

Change = Callable[[JoinMessage], JoinMessage]
REFUSED, ENDED = RefuseReason.REFUSED, RefuseReason.ENDED


def clock() -> int:
    return NOW


@pytest.fixture
def home(tmp_path: Path) -> JoinSite:
    return JoinSite(tmp_path / "site")


@asynccontextmanager
async def between(home: JoinSite, change: Change) -> AsyncIterator[list[bytes]]:
    """Mallory between the node and the port: `change` sees every message; all are recorded."""
    seen: list[bytes] = []

    async def call(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        there, back = await asyncio.open_connection("127.0.0.1", server.port)
        await asyncio.gather(carry(reader, back), carry(there, writer))

    async def carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(EOFError, OSError):
            while True:
                data = await reader.readexactly(length(await reader.readexactly(4)))
                seen.append(data)
                writer.write(frame(write(change(read(data)))))
        writer.close()

    async with home.serving() as server:
        front = await asyncio.start_server(call, "127.0.0.1", 0)
        async with front:
            home.address = f"127.0.0.1:{front.sockets[0].getsockname()[1]}"
            yield seen


@pytest.mark.attack("join-code")
async def test_the_network_does_not_see_the_secret_and_cannot_use_what_it_sees(home: JoinSite) -> None:
    csr, mine = asked("/fleet/a"), asked("/fleet/mallory")
    async with between(home, lambda message: message) as seen:
        code = home.invite(uses=2)
        await join.join(code, lambda _: csr, clock)
    assert not any(code.secret in data for data in seen)
    [sent] = [found for found in map(read, seen) if isinstance(found, Join)]
    async with home.serving() as server:
        core = NodeJoin(code, fresh())  # its hello needs the id only, which she has seen
        for change in (sent, replace(sent, csr=mine), replace(sent, name="/fleet/mallory")):
            reader, writer = await asyncio.open_connection("127.0.0.1", server.port)
            sessions.send(writer, core.hello())
            await sessions.receive(reader)
            sessions.send(writer, write(change))
            assert read(await sessions.receive(reader)) == RefusedMessage(REFUSED)
            writer.close()
    assert len(home.store.invitations.uses(code.id)) == 1


@pytest.mark.attack("join-code")
def test_secrets_are_guessed(home: JoinSite) -> None:
    code = home.invite()
    for _ in range(50):
        guess = replace(code, secret=secrets.token_bytes(16))
        request = replace(home.request(guess, asked("/fleet/a")), invitation=code.id)
        assert refusal(invitations.join(home.authority, request, NOW)) is REFUSED
    issued(home.join(code))  # guesses do not end it for its owner


@pytest.mark.attack("join-code")
def test_a_stolen_code_after_its_time_its_uses_or_its_end(home: JoinSite) -> None:
    late, used, ended = home.invite(), home.invite(), home.invite()
    assert refusal(home.join(late, "/fleet/m", now=NOW + HOUR + 1)) is ENDED
    issued(home.join(used, "/fleet/a"))
    assert refusal(home.join(used, "/fleet/m")) is ENDED
    home.store.invitations.end(ended.id, "stolen", NOW)
    assert refusal(home.join(ended, "/fleet/m")) is ENDED
    home.store.invitations.end_all("restored from a backup", NOW)
    assert home.store.identities.by_name("/fleet/m") == []


@pytest.mark.attack("join-code")
@pytest.mark.parametrize("fails", [True, False])
async def test_an_expiry_or_pattern_changed_in_the_code_changes_nothing(home: JoinSite, fails: bool) -> None:
    """They are the authority's to decide: the code only repeats them."""
    code = replace(home.invite(lasts=60), pattern="/**", expires=NOW + 10 * HOUR)
    now = NOW + 61 if fails else NOW
    request = home.request(code, asked("/fleet/a" if fails else "/other/a"))
    answer = invitations.join(home.authority, request, now)
    assert refusal(answer) is (ENDED if fails else RefuseReason.NAME)


@pytest.mark.attack("join-code")
def test_the_last_use_is_taken_once_by_many_at_once(home: JoinSite) -> None:
    """Each has a connection to the record of its own, as processes have."""
    code = home.invite(uses=2)
    requests = [home.request(code, asked(f"/fleet/r{number}")) for number in range(8)]
    answers: list[JoinAnswer] = []
    start = threading.Barrier(len(requests))

    def ask(request: JoinRequest) -> None:
        with closing(Store.open(home.site.root / "ca.db")) as store:
            authority = SigningAuthority(home.authority.authority, store, home.site.root)
            start.wait()
            answers.append(invitations.join(authority, request, NOW))

    threads = [threading.Thread(target=ask, args=(request,)) for request in requests]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert sum(isinstance(answer, Issued) for answer in answers) == 2
    assert sum(answer == RefusedMessage(ENDED) for answer in answers) == 6
    assert len(home.store.invitations.uses(code.id)) == 2
    home.store.log.audit(home.site.anchor.public_key)


@pytest.mark.attack("join-impostor")
@pytest.mark.parametrize("name", ["/robot", "/master", "/fleet/ca", "/ca_1"])
async def test_an_enrolled_node_that_plays_the_authority_gets_nothing(home: JoinSite, name: str) -> None:
    """It has a chain to the root that the code names: a hash of the root alone would pass it."""
    own = home.site.enroll(name).credentials()
    harvested: list[JoinRequest] = []

    async def harvest(request: JoinRequest) -> JoinAnswer:
        harvested.append(request)
        return WaitingMessage(WaitReason.LOCKED)

    fake = JoinServer(lambda: LiveIdentity(own.signer, own.chain, home.root), harvest)
    async with home.serving(fake):
        with pytest.raises(EnrollmentRefused, match="a node of this site"):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    assert harvested == []


@pytest.mark.attack("join-impostor")
async def test_a_copied_certificate_and_a_recorded_welcome_are_not_live(home: JoinSite) -> None:
    true = home.identity()
    fake = JoinServer(lambda: replace(true, signer=new_signer()), home.admit)
    async with home.serving(fake):
        with pytest.raises(EnrollmentRefused, match="does not have the key"):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    async with between(home, lambda message: message) as seen:
        code = home.invite(uses=2)
        await join.join(code, lambda _: asked("/fleet/a"), clock)

    async def replay(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        await sessions.receive(reader)
        sessions.send(writer, seen[1])
        writer.close()

    server = await asyncio.start_server(replay, "127.0.0.1", 0)
    async with server:
        where = f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
        with pytest.raises(EnrollmentRefused, match="does not have the key"):
            await join.join(replace(code, address=where), lambda _: asked("/fleet/a"), clock)


@pytest.mark.attack("join-impostor")
async def test_an_answer_that_is_not_the_authoritys_is_not_taken(home: JoinSite, tmp_path: Path) -> None:
    """Another authority's identity for the node's own request, or another node's."""
    mallory, csr = JoinSite(tmp_path / "mallory"), asked("/fleet/a")
    other = home.site.enroll("/fleet/b").credentials().chain
    forged = mallory.authority.authority.issue(csr, now=NOW, serial=7)
    for chain in ((forged,), other):

        def swap(message: JoinMessage, chain: tuple[bytes, ...] = chain) -> JoinMessage:
            return Issued(chain) if isinstance(message, Issued) else message

        async with between(home, swap):
            with pytest.raises(EnrollmentRefused, match=refusal_texts.OFFER_REFUSED):
                await join.join(home.invite(), lambda _: csr, clock)


@pytest.mark.attack("join-impostor")
async def test_a_request_swapped_on_its_way(home: JoinSite) -> None:
    def swap(message: JoinMessage) -> JoinMessage:
        return replace(message, csr=asked("/fleet/a")) if isinstance(message, Join) else message

    async with between(home, swap):
        with pytest.raises(JoinRefused):
            await join.join(home.invite(), lambda _: asked("/fleet/a"), clock)
    assert home.store.identities.by_name("/fleet/a") == []


@pytest.mark.attack("join-name")
def test_names_that_an_invitation_does_not_give(home: JoinSite) -> None:
    code, wide = home.invite(uses=9), home.invite("/**", uses=9)
    for name in ("/other", "/fleet", "/fleet/a/b", "/fleetx/a"):
        assert refusal(home.join(code, name)) is RefuseReason.NAME
    for name in ("/ca", "/master", "/master/kitchen"):
        assert refusal(home.join(wide, name)) is RefuseReason.NAME
    request = home.request(replace(code, wildcard=True), asked("/fleet/a", wildcard=True))
    assert refusal(invitations.join(home.authority, request, NOW)) is RefuseReason.REQUEST
    assert home.store.invitations.uses(code.id) == home.store.invitations.uses(wide.id) == []


@pytest.mark.attack("join-name")
@pytest.mark.parametrize("revoked", [True, False])
def test_the_name_of_a_node_is_not_taken_over(home: JoinSite, revoked: bool) -> None:
    """Also not that of a stolen robot whose identity was revoked: the thief may have the code."""
    code = home.invite(uses=9)
    issued(home.join(code, "/fleet/a"))
    if revoked:
        home.authority.revoke_identity("/fleet/a", "stolen", NOW)
    assert home.join(code, "/fleet/a") == WaitingMessage(WaitReason.PERSON)
    assert len(home.store.identities.by_name("/fleet/a")) == 1


@pytest.mark.attack("join-flood")
def test_what_waits_for_a_person_is_bounded_for_a_code(home: JoinSite) -> None:
    code = home.invite(uses=100)
    issued(home.join(code, "/fleet/a"))
    answers = [home.join(code, "/fleet/a") for _ in range(invitations.MAX_WAITING + 5)]
    assert len(home.store.requests.open()) == invitations.MAX_WAITING
    assert answers[-5:] == [RefusedMessage(RefuseReason.BUSY)] * 5
    issued(home.join(home.invite(), "/fleet/b"))


@pytest.mark.attack("join-flood")
async def test_open_sessions_do_not_keep_another_host_out(home: JoinSite) -> None:
    async with home.serving() as server:
        held = [await asyncio.open_connection("127.0.0.1", server.port) for _ in range(40)]
        sock = await asyncio.open_connection("127.0.0.1", server.port, local_addr=("127.0.0.2", 0))
        core = NodeJoin(home.invite(), fresh())
        sessions.send(sock[1], core.hello())
        async with asyncio.timeout(20):
            core.receive(await sessions.receive(sock[0]), NOW)
            sessions.send(sock[1], core.join(asked("/fleet/a")))
            core.receive(await sessions.receive(sock[0]), NOW)
        assert core.identity.root == home.root
        for _, writer in (*held, sock):
            writer.close()


@pytest.mark.attack("join-flood")
def test_a_stranger_reaches_no_parser(home: JoinSite, monkeypatch: pytest.MonkeyPatch) -> None:
    def parser(*_: object, **__: object) -> None:
        raise AssertionError("parsed")

    code = home.invite()
    request = home.request(code, asked("/fleet/a"))
    monkeypatch.setattr(invitations, "check_request", parser)
    for number in range(200):
        lying = replace(request, csr=number.to_bytes(2) * 1024)
        assert refusal(invitations.join(home.authority, lying, NOW)) is REFUSED
    with pytest.raises(AssertionError, match="parsed"):
        invitations.join(home.authority, request, NOW)
