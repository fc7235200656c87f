"""Topics of nodes against a real master over real sockets: delivery, filters, names, refusals."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from ca.encoding import Value
from ca.errors import NameRefused
from grants.model import Restriction, filter_rules
from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.errors import ConfigurationError, HandshakeFailed, MessageError, RossecError
from tests.support.poses import POSE, first, pose
from tests.support.site import Site, coarse
from tests.support.witness import until


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


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
async def test_topics_work_with_every_post_quantum_policy(tmp_path: Path, policy: str) -> None:
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


async def test_certificates_of_known_peers_are_sent_as_hashes(
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


async def test_pseudonyms_are_equal_and_rates_count_per_subscriber(site: Site) -> None:
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
        assert [connection.withheld for connection in publisher.links.values()] == [2, 2]
    assert seen[0] == seen[1]
    assert len(seen[0]) == 12


async def test_each_subscriber_receives_what_its_grant_allows(site: Site) -> None:
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


async def test_relative_names_and_remappings_are_resolved_as_in_ros(site: Site) -> None:
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


async def test_a_second_publisher_of_a_topic_in_one_node_is_refused(site: Site) -> None:
    site.publish("/robot", "/robot/pose")
    async with site.node("/robot") as robot:
        await robot.publisher("/robot/pose", POSE)
        with pytest.raises(ConfigurationError, match="published by this node already"):
            await robot.publisher("/robot/pose", POSE)


async def test_an_unknown_type_is_refused_before_the_master_is_called(site: Site) -> None:
    async with site.node("/robot") as robot:
        with pytest.raises(MessageError):
            await robot.publisher("/robot/pose", "geometry_msgs/Poze")


async def test_a_malformed_message_is_dropped(site: Site, caplog: pytest.LogCaptureFixture) -> None:
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


async def test_an_invalid_request_topic_answer_is_retried(
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


async def test_nothing_is_published_below_remote(site: Site) -> None:
    site.publish("/robot", "/**")
    async with site.node("/robot", "pose:=/remote/hospital/pose") as robot:
        for name in ("/remote/hospital/pose", "pose"):
            with pytest.raises(ConfigurationError, match="/remote/hospital/pose cannot be publish"):
                await robot.publisher(name, POSE)
        with pytest.raises(NameRefused, match="names no origin"):
            await robot.subscriber("/remote/hospital", POSE)
