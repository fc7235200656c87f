"""The session with a master whose revocation list is older than the node's."""

from pathlib import Path

import pytest

from ca.errors import RevocationRefused
from ca.revocation.tree import RevocationTree, sign_tree
from rossec.ros.names import MASTER
from rossec.ros.settings import parse_uri
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
