"""Nodes against a real master over real sockets: revocation, expiry, restarts, identities."""

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from ca.errors import CAError, CertificateExpired, RevocationRefused
from grants.model import Right
from grants.renewal import open_delegation
from rossec.errors import ConfigurationError, NodeShutdown, RossecError
from rossec.node import Node
from rossec.participant.membership import MasterSession
from tests.support.poses import POSE, first, pose, tell_master
from tests.support.site import DAY, HOUR, Site
from tests.support.witness import until


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


async def test_revoking_a_grant_closes_its_topic_and_no_other(site: Site) -> None:
    site.publish("/robot", "/robot/**")
    site.subscribe("/viewer", "/robot/pose")
    revoked = site.subscribe("/viewer", "/robot/scan")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        other = await robot.publisher("/robot/pose", POSE)
        scan = await robot.publisher("/robot/scan", "sensor_msgs/LaserScan")
        await viewer.subscriber("/robot/pose", POSE)
        await viewer.subscriber("/robot/scan", "sensor_msgs/LaserScan")
        await other.wait_for_subscribers()
        await scan.wait_for_subscribers()
        await tell_master(site, robot, site.revoke(revoked))
        await until(lambda: not scan.links)
        assert len(other.links) == 1


async def test_revoking_a_key_closes_all_connections_of_its_node(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        await tell_master(site, robot, site.revoke(site.identity("/viewer").thumbprint))
        await until(lambda: not publisher.links)


async def test_subscribers_close_the_connection_of_a_revoked_publisher(site: Site) -> None:
    right = site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        await tell_master(site, viewer, site.revoke(right))
        await until(lambda: not subscriber.links and not publisher.links)


async def test_an_expiring_grant_closes_its_connection(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose", lifetime=2)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        begin = time.time()
        await until(lambda: not publisher.links)
        assert time.time() - begin < 3


async def test_the_error_of_a_node_that_is_not_enrolled_has_a_hint(site: Site) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Node("/nobody", environ=site.environ)
    assert "rossec node request /nobody" in caught.value.hint


async def test_a_second_node_of_a_name_ends_the_first(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    async with site.node("/robot") as old:
        await old.publisher("/robot/pose", POSE)
        async with site.node("/robot") as new:
            await new.publisher("/robot/pose", POSE)
            with pytest.raises(NodeShutdown):
                async with asyncio.timeout(30):
                    await old.wait_ended()


async def test_a_node_survives_a_restart_of_its_master(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    assert site.master is not None
    async with site.node("/robot") as robot:
        publisher = await robot.publisher("/robot/pose", POSE)
        await site.restart_master()
        async with site.node("/viewer") as viewer:
            await viewer.subscriber("/robot/pose", POSE)
            async with asyncio.timeout(30):
                await publisher.wait_for_subscribers()


async def test_a_node_refuses_an_older_list_after_its_own_restart(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    newest, home = site.revoke(bytes(32)), site.enroll("/robot")
    home.save_revocations(newest)

    async def keep_it(_: MasterSession) -> bool:
        return False

    with monkeypatch.context() as silent:
        silent.setattr(MasterSession, "_send_held_list", keep_it)
        with pytest.raises(RevocationRefused, match="older"):
            async with site.node("/robot"):
                pass
    async with site.node("/robot") as robot:
        assert robot.revocations.data == newest == home.load_revocations()


async def test_the_graph_right_alone_allows_get_system_state(site: Site) -> None:
    site.grant("/tool", Right.GRAPH, "/**")
    async with site.node("/tool") as tool:
        state = await tool._membership.session.call("getSystemState")
    assert state == [[], [], []]


async def test_a_grant_that_arrives_later_is_used(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        with pytest.raises(RossecError, match="subscribe"):
            await viewer.subscriber("/robot/pose", POSE)
        site.subscribe("/viewer", "/robot/pose")
        await until(lambda: viewer.access.current(int(time.time())))
        await until_registered(viewer)
        await publisher.wait_for_subscribers()


async def until_registered(viewer: Node) -> None:
    async with asyncio.timeout(30):
        while True:
            try:
                await viewer.subscriber("/robot/pose", POSE)
            except RossecError:
                await asyncio.sleep(0.05)
            else:
                return


async def test_a_node_ends_when_its_watchdog_fails(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()

        def break_down(_: int) -> None:
            raise ValueError("boom")

        monkeypatch.setattr(robot._context.connections, "cut_ended", break_down)
        with pytest.raises(ValueError, match="boom"):
            async with asyncio.timeout(30):
                await robot.wait_ended()
        await until(lambda: not publisher.links)
        await asyncio.sleep(1)  # longer than a subscriber waits before it tries again
        assert not publisher.links
        with pytest.raises(NodeShutdown):
            publisher.publish(pose(publisher))


async def test_a_node_that_the_master_ended_is_closed_when_its_watchdog_fails(site: Site) -> None:
    """The program may not have noticed its end yet."""
    site.publish("/robot", "/robot/pose")
    async with site.node("/robot") as robot:
        publisher = await robot.publisher("/robot/pose", POSE)
        robot.shutdown_requested("a test")
        robot.crashed(ValueError("boom"))
        await until(lambda: not robot._membership.tasks, within=10)
        with pytest.raises(NodeShutdown):
            publisher.publish(pose(publisher))


async def test_an_invalid_grant_file_is_logged_and_ignored(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.publish("/robot", "/robot/pose")
    (site.enroll("/robot").path / "grants" / "bad.grant").write_bytes(b"no grant")
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        (robot.home.path / "grants" / "huge.grant").write_bytes(bytes(300_000))
        await until(lambda: "huge.grant cannot be read" in caplog.text)
        assert caplog.text.count("is not a valid grant") == 1


async def test_a_revoked_publisher_is_not_called(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        await robot.publisher("/robot/pose", POSE)
        asked: list[str] = []

        def endpoint() -> tuple[str, int]:
            asked.append("requestTopic")
            return "127.0.0.1", 1

        monkeypatch.setattr(robot, "topic_endpoint", endpoint)
        revoked = site.revoke(site.identity("/robot").thumbprint)
        viewer.revocations.update(revoked, int(time.time()))
        with pytest.raises(CAError):
            await viewer._dialer.topic(robot.uri, "/robot/pose")
        assert asked == []


async def test_an_identity_in_another_nodes_directory_is_refused_at_once(site: Site) -> None:
    home = site.enroll("/robot")
    home.path.rename(home.path.with_name("robbie"))
    with pytest.raises(ConfigurationError, match="holds the identity of /robot, not of /robbie"):
        Node("/robbie", environ=site.environ)


async def test_an_expired_identity_is_refused_at_once(site: Site) -> None:
    site.enroll("/robot", lifetime=1)
    await asyncio.sleep(2.1)
    with pytest.raises(CertificateExpired, match="/robot"):
        Node("/robot", environ=site.environ)


async def test_a_node_that_was_off_for_long_has_its_grants_renewed(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    delegation = site.delegate()
    old: dict[str, Any] = {"begin": site.now() - HOUR, "lifetime": -60, "cap": DAY}
    site.grant("/robot", Right.PUBLISH, "/robot/pose", **old)
    site.grant("/viewer", Right.SUBSCRIBE, "/robot/pose", **old)
    async with site.running(), site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE, latch=True)
        publisher.publish(pose(publisher))
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        await first(subscriber)
        [connection] = publisher.links
        assert len(connection.decision.grant_ids) == 3  # the grant, the delegation and the delegate
        id_ = open_delegation(delegation, site.anchor.public_key).id
        site.authority.revoke(id_, "withdrawn", site.now())
        data = site.authority.store.newest_list()
        await robot._membership.session.call("rossec.updateRevocations", data)
        await until(lambda: not publisher.links and not subscriber.links)


async def test_without_a_delegation_an_expired_grant_stays_expired(site: Site) -> None:
    site.grant("/robot", Right.PUBLISH, "/robot/pose", begin=site.now() - HOUR, lifetime=-60, cap=DAY)
    async with site.node("/robot") as robot:
        with pytest.raises(RossecError, match="publish"):
            await robot.publisher("/robot/pose", POSE)


async def test_a_node_is_told_the_types_of_topics_that_it_may_see(site: Site) -> None:
    site.publish("/robot", "/**")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        await robot.publisher("/robot/pose", POSE)
        await robot.publisher("/robot/scan", "sensor_msgs/LaserScan")
        assert await viewer.topic_types() == {"/robot/pose": POSE}
        assert len(await robot.topic_types()) == 2
