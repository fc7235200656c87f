"""Grants from the master: what is taken and asked for, and the connection that waits."""

import asyncio
import secrets
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import pytest

from ca.certificates import Identity
from grants import document
from grants.model import Draft, Permission, Right
from rossec.errors import AnswerMalformed, AnswerRefused, RossecError
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, connect, serve
from rossec.net.rpc.calls import serve_calls
from rossec.participant import master_updates as module
from rossec.participant.access import Access
from rossec.participant.master_updates import (
    FETCH,
    MAX_ANSWERS,
    MAX_KNOWN,
    WATCH,
    GrantDelivery,
    GrantDirectory,
    GrantWatch,
)
from rossec.participant.membership import LoadedIdentity
from rossec.ros.names import MASTER
from rossec.ros.xmlrpc import Fault
from tests.support.site import DAY, HOUR, Site
from tests.support.trust import accept
from tests.support.witness import until


class Robot:
    """A node, and a master that answers from `answers`, then waits."""

    def __init__(self, root: Path) -> None:
        self.site = Site(root / "site")
        self.home = self.site.enroll("/robot")
        loaded = self.loaded = LoadedIdentity(self.home, "/robot")
        self.access = Access(loaded.trust_status)
        self.directory = GrantDirectory(self.home, self.access)
        self.delivery = GrantDelivery(
            loaded.trust_status, loaded.identity.thumbprint, self.access, self.directory
        )
        self.answers: list[Any] = []
        self.asked: list[tuple[str, bytes]] = []
        self.open = True
        self.watch = GrantWatch("/robot", self.delivery, self.dial, lambda: self.open)
        self.master = MASTER
        self.dialed = 0
        self.server: SecureServer[Identity] | None = None

    def grant(self, begin: int = -60, lifetime: int = DAY, **changes: Any) -> bytes:
        now = self.site.now()
        draft = Draft(
            domain=changes.get("domain", "home"),
            subject="/robot",
            holder=changes.get("holder", self.loaded.identity.thumbprint),
            not_before=now + begin,
            expires=now + begin + lifetime,
            cap=now + begin + lifetime + changes.get("more", 0),
            serial=secrets.token_bytes(16),
            permissions=(Permission("/p", Right.PUBLISH),),
        )
        return document.sign(changes.get("signer", self.site.authority.signer), draft)

    async def call(self, method: str, *params: object) -> object:
        assert isinstance(params[0], bytes)
        self.asked.append((method, params[0]))
        answer = self.answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer

    async def dispatch(self, method: str, params: tuple[object, ...], peer: Identity) -> object:
        assert (params[0], peer.name) == ("/robot", "/robot")
        if not self.answers:
            await asyncio.Event().wait()
        return [1, "", await self.call(method, *params[1:])]

    async def dial(self) -> SecureStream[Identity]:
        self.dialed += 1
        assert self.server is not None
        context = SecureContext(self.loaded.live_credentials, self.loaded.anchor.verify)
        return await connect("127.0.0.1", self.server.port, context, WireProtocol.HTTP)

    @asynccontextmanager
    async def watching(self) -> AsyncIterator["asyncio.Task[None]"]:
        home = self.site.enroll(self.master)

        async def handle(stream: SecureStream[Identity]) -> None:
            await serve_calls(stream, self.dispatch)

        own = SecureContext(home.credentials(), home.anchor().verify)
        async with serve(handle, "127.0.0.1", 0, own, WireProtocol.HTTP) as server:
            self.server = server
            task = asyncio.ensure_future(self.watch.run())
            try:
                yield task
            finally:
                task.cancel()
                await asyncio.wait([task])

    def files(self) -> list[bytes]:
        return sorted(self.home.grants())


def answer(*grants: object, more: bool = False) -> dict[str, object]:
    return {"grants": list(grants), "more": more}


@pytest.fixture
def robot(tmp_path: Path) -> Robot:
    return Robot(tmp_path)


async def test_everything_is_fetched_stored_and_held(robot: Robot) -> None:
    one, two = robot.grant(), robot.grant()
    robot.answers = [answer(one, more=True), answer(two)]
    await robot.delivery.fetch(robot.call)
    assert robot.asked == [(FETCH, b""), (FETCH, document.grant_id(one))]
    assert robot.files() == [], "used first: a disk may be slow"
    await robot.delivery.save()
    await robot.delivery.save()
    assert robot.files() == sorted([one, two])
    assert {each.token for each in robot.access.held_grants()} == {one, two}
    assert robot.delivery.take_new() == [one, two]
    assert robot.delivery.take_new() == []
    assert robot.delivery.supported.is_set()


async def test_a_grant_of_use_later_or_after_a_renewal_is_taken(robot: Robot) -> None:
    grants = [robot.grant(begin=HOUR), robot.grant(begin=-HOUR, lifetime=60, more=DAY)]
    robot.delivery.take(answer(*grants))
    await robot.delivery.save()
    assert robot.files() == sorted(grants)


def refused_grants(robot: Robot) -> list[tuple[bytes, str]]:
    other = Site(robot.site.root / "other")
    revoked = robot.grant()
    robot.loaded.revocations.update(robot.site.revoke(revoked), robot.site.now(), lambda _: None)
    return [
        (robot.grant(signer=other.authority.signer), "not a grant of this authority"),
        (robot.grant(domain="away"), "not 'home'"),
        (robot.grant(holder=bytes(32)), "bound to another key"),
        (robot.grant(begin=-HOUR, lifetime=60), "has expired"),
        (revoked, "is revoked"),
    ]


async def test_what_the_master_must_not_deliver_is_refused_once(
    robot: Robot, caplog: pytest.LogCaptureFixture
) -> None:
    """It is trusted for no right: a stolen master's key makes no grant."""
    for data, reason in refused_grants(robot):
        caplog.clear()
        robot.delivery.take(answer(data))
        assert "a grant that the master delivers is refused" in caplog.text
        assert reason in caplog.text
        assert document.grant_id(data) in robot.delivery.known(), "it is not asked for again"
    robot.delivery.take(answer(b"noise"))
    await robot.delivery.save()
    assert robot.files() == []
    assert robot.access.held_grants() == []
    assert robot.delivery.taken == 0


async def test_a_forged_grant_keeps_the_real_one_away_only_for_the_session(robot: Robot) -> None:
    """By its id: the next master, or this one after it was repaired, has the real one."""
    real = robot.grant()
    forged = real[:-1] + bytes([real[-1] ^ 1])
    robot.answers = [answer(forged), answer(real)]
    await robot.delivery.fetch(robot.call)
    assert robot.access.held_grants() == []
    await robot.delivery.fetch(robot.call)
    assert robot.asked[-1] == (FETCH, b"")
    assert [held.original for held in robot.access.held_grants()] == [real]


@pytest.mark.parametrize(
    "value", [None, 7, {}, {"grants": b"x", "more": False}, answer(more=True), answer("text")]
)
def test_a_malformed_answer_is_an_error(robot: Robot, value: object) -> None:
    with pytest.raises(AnswerMalformed):
        robot.delivery.take(value)


async def test_a_master_that_always_has_more_does_not_hold_the_session_up(robot: Robot) -> None:
    data = robot.grant()
    robot.answers = [answer(data, more=True)] * (MAX_ANSWERS + 1)
    await robot.delivery.fetch(robot.call)
    assert len(robot.answers) == 1
    assert robot.delivery.taken == 1


@pytest.mark.parametrize("error", [Fault(1, "not supported"), AnswerRefused("rossec: no rule")])
async def test_an_older_master_is_used_without_delivery(
    robot: Robot, error: Exception, caplog: pytest.LogCaptureFixture
) -> None:
    robot.answers = [answer(), error]
    await robot.delivery.fetch(robot.call)
    await robot.delivery.fetch(robot.call)
    assert not robot.delivery.supported.is_set()
    assert caplog.text == ""
    async with robot.watching():
        await asyncio.sleep(0.05)
    assert robot.dialed == 0


def test_what_is_known_is_bounded_the_newest_first(robot: Robot) -> None:
    held = robot.grant()
    robot.access.hold(held)
    grants = [robot.grant(holder=bytes(32)) for _ in range(MAX_KNOWN + 1)]
    for data in grants:
        robot.delivery.take(answer(data))
    known = robot.delivery.known()
    assert len(known) == 16 * MAX_KNOWN
    assert known.startswith(document.grant_id(grants[-1]))
    assert document.grant_id(grants[0]) not in known


async def test_a_node_waits_for_the_next_grant(robot: Robot) -> None:
    one, two = robot.grant(), robot.grant()
    robot.delivery.supported.set()
    waiting = asyncio.ensure_future(robot.delivery.wait(30))
    robot.answers = [answer(one), answer(two)]
    async with robot.watching():
        await until(lambda: robot.delivery.taken == 2)
        async with asyncio.timeout(30):
            await waiting
        await robot.delivery.wait(30)  # not taken yet
    assert [method for method, _ in robot.asked] == [WATCH, WATCH]
    assert robot.asked[1][1] == document.grant_id(one)
    assert robot.delivery.take_new() == [one, two]
    async with asyncio.timeout(30):
        await robot.delivery.wait(0.01)


async def test_nothing_is_dialed_while_the_session_is_lost(robot: Robot) -> None:
    robot.delivery.supported.set()
    robot.open = False
    async with robot.watching():
        await asyncio.sleep(0.05)
        assert robot.dialed == 0
        robot.open, robot.answers = True, [answer(robot.grant())]
        await until(lambda: robot.delivery.taken == 1)


async def test_a_new_session_ends_the_connection_of_the_one_before(robot: Robot) -> None:
    robot.delivery.supported.set()
    await robot.watch.session_opened()
    async with robot.watching():
        await until(lambda: robot.dialed == 1)
        await asyncio.sleep(0.1)
        await robot.watch.session_opened()
        robot.answers = [answer(robot.grant())]
        await until(lambda: robot.delivery.taken == 1)
        assert robot.dialed == 2


@pytest.mark.parametrize("error", [RossecError("lost"), OSError("no route"), Fault(1, "no")])
async def test_a_lost_connection_is_made_again(
    robot: Robot, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    robot.delivery.supported.set()

    async def fail() -> SecureStream[Identity]:
        monkeypatch.undo()
        raise error

    monkeypatch.setattr(robot.watch, "_dial", fail)
    robot.answers = [answer(robot.grant())]
    async with robot.watching():
        await until(lambda: robot.delivery.taken == 1)


async def test_a_master_that_answers_at_once_with_nothing_new_is_not_asked_in_a_loop(
    robot: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "SHORTEST", 0.2)
    robot.delivery.supported.set()
    robot.answers = [answer()] * 1000
    async with robot.watching():
        await asyncio.sleep(0.5)
    assert 1 <= len(robot.asked) <= 5


async def test_only_the_master_is_asked(robot: Robot) -> None:
    robot.delivery.supported.set()
    robot.master, robot.answers = "/eve", [answer(robot.grant())]
    async with robot.watching() as task:
        await until(lambda: robot.dialed > 0)
        await asyncio.sleep(0.1)
        assert robot.asked == []
        assert not task.done(), "it is tried again: the address may have been another's for a while"


async def test_a_crash_is_not_hidden(robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.delivery.supported.set()

    async def fail() -> SecureStream[Identity]:
        raise ArithmeticError("a fault")

    monkeypatch.setattr(robot.watch, "_dial", fail)
    with pytest.raises(ArithmeticError):
        await robot.watch.run()


async def test_a_grant_of_a_listed_domain_is_delivered_too(robot: Robot, tmp_path: Path) -> None:
    """Its own root signs it; nobody signs for another domain."""
    other = Site(tmp_path / "hospital", "hospital")
    theirs = robot.grant(domain="hospital", signer=other.authority.signer)
    ours_for_theirs = robot.grant(domain="hospital")
    theirs_for_ours = robot.grant(signer=other.authority.signer)
    robot.answers = [{"grants": [theirs, ours_for_theirs, theirs_for_ours], "more": False}]
    await robot.delivery.fetch(robot.call)
    assert robot.delivery.take_new() == [], "it is not listed yet"
    robot.loaded.anchors.update(accept(robot.site, other))
    robot.answers = [{"grants": [theirs, ours_for_theirs, theirs_for_ours], "more": False}]
    await robot.delivery.fetch(robot.call)
    assert robot.delivery.take_new() == [theirs]
    assert robot.access.current(robot.site.now()) == [theirs]
    revoked = robot.grant(domain="hospital", signer=other.authority.signer)
    data = other.revoke(revoked)
    robot.loaded.trust_status.restore("hospital", data, robot.site.now())
    robot.answers = [{"grants": [revoked], "more": False}]
    await robot.delivery.fetch(robot.call)
    assert robot.delivery.take_new() == []
