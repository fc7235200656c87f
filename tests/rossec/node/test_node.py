"""Nodes against a real master over real sockets: what arrives, what does not, what is cut."""

import asyncio
import contextlib
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

import pytest

from ca.encoding import Value
from ca.errors import CAError, CertificateExpired, RollbackRefused
from ca.revocation.tree import is_tree
from grants.model import Restriction, Right, filter_rules
from grants.renewal import open_delegation
from rossec.channel.edhoc.known import KnownCertificates
from rossec.errors import (
    ConfigurationError,
    HandshakeFailed,
    MessageError,
    NodeShutdown,
    RossecError,
)
from rossec.node import Node, Publisher, Subscriber
from rossec.participant.master_session import MasterSession
from tests.support.site import DAY, HOUR, Site, coarse

POSE = "geometry_msgs/PoseStamped"


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


async def until(holds: Callable[[], object], within: float = 30.0) -> None:
    end = time.monotonic() + within
    while not holds():
        assert time.monotonic() < end, "it did not come to hold in time"
        await asyncio.sleep(0.01)


async def first(subscriber: Subscriber, within: float = 30.0) -> Any:
    async with asyncio.timeout(within):
        return await anext(aiter(subscriber))


def pose(publisher: Publisher, x: float = 3.3, frame: str = "map") -> Any:
    message = publisher.create()
    message.pose.position.x, message.header.frame_id = x, frame
    return message


async def test_a_message_arrives_as_it_was_sent(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        publisher.publish(pose(publisher))
        message = await first(subscriber)
    assert (message.pose.position.x, message.header.frame_id) == (3.3, "map")


@pytest.mark.parametrize("policy", ["prefer", "require"])
async def test_topics_by_post_quantum_policy(tmp_path: Path, policy: str) -> None:
    site = Site(tmp_path / "site")
    site.variables["ROSSEC_POST_QUANTUM"] = policy
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.running(), site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        publisher.publish(pose(publisher))
        await publisher.wait_for_subscribers()
        publisher.publish(pose(publisher))
        assert (await first(subscriber)).pose.position.x == 3.3
        site.variables["ROSSEC_POST_QUANTUM"] = "off"
        with contextlib.ExitStack() as stack:
            if policy == "require":
                stack.enter_context(pytest.raises(HandshakeFailed, match="suite"))
            async with site.node("/late"):
                pass
        site.variables["ROSSEC_POST_QUANTUM"] = "required"
        with pytest.raises(ConfigurationError) as caught:
            site.node("/later")
        assert caught.value.hint.startswith("did you mean require?")


async def test_who_met_before_names_certificates_by_their_hashes(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    found: list[Value] = []
    real = KnownCertificates.find

    def find(own: KnownCertificates, named: Value) -> tuple[bytes, ...]:
        found.append(named)
        return real(own, named)

    monkeypatch.setattr(KnownCertificates, "find", find)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        for _ in range(2):
            subscriber = await viewer.subscriber("/robot/pose", POSE)
            await publisher.wait_for_subscribers()
            await subscriber.close()
            await until(lambda: not publisher.links)
    assert any(isinstance(named, dict) and 34 in named for named in found)


async def test_the_order_of_starting_does_not_matter(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/viewer") as viewer, site.node("/robot") as robot:
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        publisher = await robot.publisher("/robot/pose", POSE, latch=True)
        publisher.publish(pose(publisher))
        assert (await first(subscriber)).pose.position.x == 3.3


async def test_pseudonyms_and_rates(site: Site) -> None:
    """Two receivers under one key see one pseudonym; a rate counts for each of them."""
    rules = filter_rules({"header.frame_id": {"hash": {"key": "frames", "length": 12}}})
    site.publish("/robot", "/robot/pose")
    for name in ("/one", "/two"):
        site.subscribe(name, "/robot/pose", Restriction(POSE, (), rules, rate=0.001))
    nodes = site.node("/robot"), site.node("/one"), site.node("/two")
    async with nodes[0] as robot, nodes[1] as one, nodes[2] as two:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscribers = [await node.subscriber("/robot/pose", POSE) for node in (one, two)]
        await publisher.wait_for_subscribers(2)
        for _ in range(3):
            publisher.publish(pose(publisher))
        seen = [(await first(subscriber)).header.frame_id for subscriber in subscribers]
        assert [link.withheld for link in publisher.links] == [2, 2]
    assert seen[0] == seen[1]
    assert len(seen[0]) == 12


async def test_each_subscriber_sees_what_its_grant_says(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/doctor", "/robot/pose")
    site.subscribe("/heating", "/robot/pose", coarse())
    nodes = site.node("/robot"), site.node("/doctor"), site.node("/heating")
    async with nodes[0] as robot, nodes[1] as doctor, nodes[2] as heating:
        publisher = await robot.publisher("/robot/pose", POSE)
        exact = await doctor.subscriber("/robot/pose", POSE)
        rough = await heating.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers(2)
        publisher.publish(pose(publisher, frame="elsewhere"))  # the condition withholds it
        publisher.publish(pose(publisher))
        assert (await first(exact)).header.frame_id == "elsewhere"
        seen = await first(rough)
        assert (seen.pose.position.x, seen.header.frame_id) == (4.0, "")
        assert rough.received == 1


async def test_a_relative_name_and_a_remapping_mean_what_they_mean_in_ros(site: Site) -> None:
    site.publish("/robot", "/far/pose")
    site.subscribe("/viewer", "/far/pose")
    async with site.node("/robot", "pose:=/far/pose") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("pose", POSE)
        assert publisher.topic == "/far/pose"
        await viewer.subscriber("/far/pose", POSE)
        await publisher.wait_for_subscribers()


async def test_a_subscriber_without_a_grant_is_refused_by_the_master(site: Site) -> None:
    async with site.node("/viewer") as viewer:
        with pytest.raises(RossecError, match="subscribe"):
            await viewer.subscriber("/robot/pose", POSE)


async def test_a_publisher_without_a_grant_is_refused_by_the_master(site: Site) -> None:
    async with site.node("/robot") as robot:
        with pytest.raises(RossecError, match="publish"):
            await robot.publisher("/robot/pose", POSE)


async def test_revoking_a_grant_cuts_its_topic_and_no_other(site: Site) -> None:
    site.publish("/robot", "/robot/**")
    site.subscribe("/viewer", "/robot/pose")
    revoked = site.subscribe("/viewer", "/robot/scan")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        kept = await robot.publisher("/robot/pose", POSE)
        cut = await robot.publisher("/robot/scan", "sensor_msgs/LaserScan")
        await viewer.subscriber("/robot/pose", POSE)
        await viewer.subscriber("/robot/scan", "sensor_msgs/LaserScan")
        await kept.wait_for_subscribers()
        await cut.wait_for_subscribers()
        await tell_master(site, robot, site.revoke(revoked))
        await until(lambda: not cut.links)
        assert len(kept.links) == 1


async def test_revoking_a_key_cuts_everything_of_its_node(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        await tell_master(site, robot, site.revoke(site.identity("/viewer").thumbprint))
        await until(lambda: not publisher.links)


async def test_a_revoked_publisher_is_cut_by_its_subscribers(site: Site) -> None:
    right = site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        await tell_master(site, viewer, site.revoke(right))
        await until(lambda: not subscriber.links and not publisher.links)


async def test_an_expiring_grant_cuts_its_connection(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose", lifetime=2)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        begin = time.time()
        await until(lambda: not publisher.links)
        assert time.time() - begin < 3


async def test_two_publishers_of_one_topic_in_one_node_are_a_mistake(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        with pytest.raises(ConfigurationError, match="published by this node already"):
            await robot.publisher("/robot/pose", POSE)


async def test_an_unknown_type_is_refused_before_the_master_hears_of_it(site: Site) -> None:
    async with site.node("/robot") as robot:
        with pytest.raises(MessageError):
            await robot.publisher("/robot/pose", "geometry_msgs/Poze")


async def test_a_node_that_is_not_enrolled_says_what_to_do(site: Site) -> None:
    with pytest.raises(ConfigurationError) as caught:
        Node("/nobody", environ=site.environ)
    assert "rossec node request /nobody" in caught.value.hint


async def test_the_second_node_of_a_name_ends_the_first(site: Site) -> None:
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
        with pytest.raises(RollbackRefused, match="older"):
            async with site.node("/robot"):
                pass
    async with site.node("/robot") as robot:
        assert robot.revocations.data == newest == home.load_revocations()


async def tell_master(site: Site, node: Node, revocations: bytes) -> None:
    if is_tree(revocations):
        await node._session.call("rossec.updateRevocationTree", revocations, site.entries)
    else:
        await node._session.call("rossec.updateRevocations", revocations)


async def test_graph_right_is_a_right_of_its_own(site: Site) -> None:
    site.grant("/tool", Right.GRAPH, "/**")
    async with site.node("/tool") as tool:
        state = await tool._session.call("getSystemState")
    assert state == [[], [], []]


async def test_a_grant_that_arrives_later_counts(site: Site) -> None:
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


async def test_a_node_whose_watch_dies_ends(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()

        def break_down(_: int) -> None:
            raise ValueError("boom")

        monkeypatch.setattr(robot._watchdog, "close_terminated", break_down)
        with pytest.raises(ValueError, match="boom"):
            async with asyncio.timeout(30):
                await robot.wait_ended()
        await until(lambda: not publisher.links)
        await asyncio.sleep(1)  # longer than a subscriber waits before it tries again
        assert not publisher.links
        with pytest.raises(NodeShutdown):
            publisher.publish(pose(publisher))


async def test_a_bad_grant_file_is_told_and_does_no_harm(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.publish("/robot", "/robot/pose")
    (site.enroll("/robot").path / "grants" / "bad.grant").write_bytes(b"no grant")
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        (robot.home.path / "grants" / "huge.grant").write_bytes(bytes(300_000))
        await until(lambda: "huge.grant cannot be read" in caplog.text)
        assert caplog.text.count("is not a valid grant") == 1


async def test_a_malformed_message_is_left_out(
    site: Site, caplog: pytest.LogCaptureFixture
) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        publisher.publish_bytes(b"not a pose")
        publisher.publish(pose(publisher))
        assert (await first(subscriber)).pose.position.x == 3.3
        assert "dropped a message" in caplog.text


async def test_a_closed_subscriber_stays_closed(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    site.publish("/other", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        await publisher.wait_for_subscribers()
        await subscriber.close()
        await subscriber.close()
        await until(lambda: not publisher.links)
        async with site.node("/other") as other:
            second = await other.publisher("/robot/pose", POSE)
            subscriber.update([other.uri])
            await asyncio.sleep(0.3)
            assert not second.links
        assert [item async for item in subscriber] == []


async def test_an_odd_answer_does_not_end_the_following(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.publish("/robot", "/robot/pose")
    site.subscribe("/viewer", "/robot/pose")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        publisher = await robot.publisher("/robot/pose", POSE)
        answers = iter([("127.0.0.1", 99999), ("a..b", 1), ("\u2603" * 80, 1)])
        endpoint = robot.topic_endpoint()
        monkeypatch.setattr(robot, "topic_endpoint", lambda: next(answers, endpoint))
        subscriber = await viewer.subscriber("/robot/pose", POSE)
        async with asyncio.timeout(20):
            await publisher.wait_for_subscribers()
        assert len(subscriber.refusals) == 3


async def test_a_revoked_publisher_is_told_nothing(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
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


async def test_an_identity_in_the_wrong_place_is_noticed_at_once(site: Site) -> None:
    home = site.enroll("/robot")
    home.path.rename(home.path.with_name("robbie"))
    with pytest.raises(ConfigurationError, match="holds the identity of /robot, not of /robbie"):
        Node("/robbie", environ=site.environ)


async def test_an_expired_identity_is_noticed_at_once(site: Site) -> None:
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
        [link] = publisher.links
        assert len(link.decision.grant_ids) == 3  # the grant, the delegation and the delegate
        id_ = open_delegation(delegation, site.anchor.public_key).id
        site.authority.revoke(id_, "withdrawn", site.now())
        data = site.authority.store.newest_list()
        await robot._session.call("rossec.updateRevocations", data)
        await until(lambda: not publisher.links and not subscriber.links)


async def test_without_a_delegation_an_expired_grant_stays_expired(site: Site) -> None:
    site.grant("/robot", Right.PUBLISH, "/robot/pose", begin=site.now() - HOUR, lifetime=-60,
               cap=DAY)  # fmt: skip
    async with site.node("/robot") as robot:
        with pytest.raises(RossecError, match="publish"):
            await robot.publisher("/robot/pose", POSE)
