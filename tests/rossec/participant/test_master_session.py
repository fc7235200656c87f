"""The session with the master: its life, and a master whose list is older than the node's."""

import asyncio
import contextlib
from functools import partial
from pathlib import Path

import pytest

from ca.certificates import Identity
from ca.errors import RevocationRefused
from ca.revocation.lists import RevocationTree, sign_tree
from rossec.errors import ConfigurationError, RossecError
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.participant.membership import MasterSession
from rossec.participant.renewals import MasterCall
from rossec.ros.names import MASTER, parse_uri
from tests.support.site import DAY, Site
from tests.support.witness import until


async def test_a_master_that_lost_its_list_receives_it_from_a_node(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    site = Site(tmp_path / "site")
    home = site.enroll(MASTER)
    async with site.running(), site.node("/robot") as robot:
        assert site.master is not None
        _, port = parse_uri(site.master.uri)
        await site.master.close()
        (home.path / "revocations.cose").unlink()
        monkeypatch.setattr(site.authority.store, "newest_list", lambda: None)
        await site.start_master(port)
        await until(lambda: home.load_revocations() == robot.revocations.data)
        await until(lambda: "the newer one: was its home restored from a backup?" in caplog.text)


async def test_a_list_that_is_missing_a_tree_or_not_newer_is_not_sent(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    async with Site(tmp_path / "site").running() as site, site.node("/robot") as robot:
        session, now = robot._membership.session, site.now()
        tree = sign_tree(site.authority.signer, RevocationTree(9, 9, now, now + DAY, 1, bytes(32)))
        for held in (lambda: b"", lambda: tree, lambda: robot.revocations.data):
            monkeypatch.setattr(session, "_held", held)
            assert not await session._send_held_list()
        assert "the master refuses" not in caplog.text
        monkeypatch.setattr(session, "_held", lambda: b"forged")
        assert not await session._send_held_list()
        assert "/robot: the master refuses this node's revocation list" in caplog.text

        def refuse(*_: object) -> None:
            raise RevocationRefused("something else is wrong with it")

        monkeypatch.setattr(session, "_refresh", refuse)
        with pytest.raises(RevocationRefused, match="something else"):
            await session._heartbeat()


def session_of(site: Site, name: str, port: int) -> tuple[MasterSession, list[MasterSession]]:
    """A session of `name` with what listens on `port`, and each time it was restored."""
    context = SecureContext(site.enroll(name).credentials(), site.anchor.verify)
    restored: list[MasterSession] = []

    async def restore(session: MasterSession) -> None:
        restored.append(session)

    async def prove(_: object) -> int:
        return 0

    def refresh(_list: bytes, _timestamp: bytes, _master: Identity) -> None:
        pass

    dial = partial(connect, "127.0.0.1", port, context, WireProtocol.HTTP)
    return MasterSession(name, dial, refresh, restore, lambda: b"", prove), restored


async def test_a_session_is_used_between_its_opening_and_its_end(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site:
        assert site.master is not None
        session, restored = session_of(site, "/robot", parse_uri(site.master.uri)[1])
        for use in (session.call, session.forward):
            with pytest.raises(RossecError, match="the master is out of reach") as caught:
                await use("getPid", "/robot")
            assert "rossec master" in caught.value.hint
        await session.open()
        assert restored == [session]
        assert await session.call("getUri") == site.master.uri
        assert await session.forward("getUri", "/robot") == [1, "", site.master.uri]
        await session.close()
        with pytest.raises(RossecError, match="the master is out of reach"):
            await session.call("getUri")


async def test_another_node_at_the_address_is_not_the_master(tmp_path: Path) -> None:
    async with Site(tmp_path / "site").running() as site, site.node("/other") as other:
        session, restored = session_of(site, "/robot", parse_uri(other.uri)[1])
        with pytest.raises(ConfigurationError, match="is /other, not /master") as caught:
            await session.open()
        assert (caught.value.hint, restored) == (
            "check ROS_MASTER_URI, and ROSSEC_MASTER if there are several masters",
            [],
        )
        with pytest.raises(RossecError, match="the master is out of reach"):
            await session.call("getUri")


async def test_a_cause_that_lasts_is_logged_once_a_minute(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    tries = []

    async def dial() -> SecureStream[Identity]:
        tries.append(1)
        raise ConnectionRefusedError("refused" if len(tries) < 4 else "unreachable")

    async def nothing(session: MasterSession) -> None:
        """No registrations."""

    async def no_proofs(call: MasterCall) -> int:
        return 0

    monkeypatch.setattr("rossec.participant.registrations.FIRST", 0.02)
    session = MasterSession("/robot", dial, lambda *_: None, nothing, bytes, no_proofs)
    running = asyncio.ensure_future(session.run())
    try:
        await until(lambda: len(tries) > 4, within=10)
        assert caplog.messages == [
            "/robot: no answer from the master: refused",
            "/robot: no answer from the master: unreachable",
        ]
        monkeypatch.setattr("rossec.participant.membership._SAID_AGAIN", 0.0)
        await until(lambda: len(caplog.messages) > 3, within=10)
    finally:
        running.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await running
