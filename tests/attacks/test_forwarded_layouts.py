"""A publisher behind a gateway sends a definition that differs from the one its readers use.

What a gateway forwards it cannot read by a type of its own: it has the publisher's text, and the
types that are installed on its host (docs/spec/gateway.md section 4).
"""

from collections.abc import AsyncIterator, Sequence
from pathlib import Path

import pytest

from grants.filters import layout
from grants.model import Restriction, Right
from rossec.node import Node
from rossec.node.publisher import RawPublisher
from rossec.node.subscriber import RawSource
from rossec.participant.definitions import Definition
from tests.attacks.test_layouts import CALM, CLAMP, CLAMPED, FAST, SLOWED, TRUE, TWIST, forged, mallory
from tests.support.site import Site
from tests.support.witness import until

pytestmark = pytest.mark.attack("forged-layout")


class Box:
    """Takes every message."""

    def __init__(self) -> None:
        self.messages: list[bytes] = []

    def connected(self, source: RawSource) -> None:
        pass

    def received(self, _: RawSource, messages: Sequence[bytes]) -> None:
        self.messages += messages

    def disconnected(self, source: RawSource) -> None:
        pass

    def refused(self, error: Exception) -> None:
        raise AssertionError from error


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    site = Site(tmp_path / "site")
    site.grant("/mallory", Right.PUBLISH, CLAMPED, restriction=Restriction(TWIST, (), CLAMP))
    site.subscribe("/box", CLAMPED)
    site.publish("/forwarder", CLAMPED)
    site.subscribe("/free", CLAMPED)
    site.subscribe("/robot", CLAMPED, restriction=Restriction(TWIST, (), CLAMP))
    async with site.running() as site:
        yield site


async def test_what_a_publisher_may_send_is_judged_by_the_definition_of_this_host(site: Site) -> None:
    box = Box()
    async with site.node("/box") as node, mallory(site, CLAMPED) as publisher:
        await node.topics.subscribe_raw(CLAMPED, box)
        await publisher.wait_for_subscribers()
        for message in (FAST, CALM):
            publisher.publish_bytes(message)
        await until(lambda: len(box.messages) == 2, within=20)
    assert box.messages == [SLOWED, CALM]


async def forwarding(node: Node, definition: str) -> RawPublisher:
    made = await node.topics.publish_raw(CLAMPED, TWIST, lambda: None, queue_size=10)
    made.describe(Definition(TWIST, TRUE.md5sum, definition))
    made.forward("mallory", FAST, keep=True)
    return made


async def test_a_restricted_reader_gets_nothing_by_a_definition_that_is_not_its_own(site: Site) -> None:
    """Who has no restriction gets the bytes as they are."""
    async with site.node("/forwarder") as forwarder, site.node("/robot") as robot:
        publisher = await forwarding(forwarder, forged(CLAMPED))
        subscriber = await robot.subscriber(CLAMPED, TWIST)
        await until(lambda: bool(subscriber.refusals), within=20)
        assert "is not the one this host knows" in str(subscriber.refusals[0])
        async with site.node("/free") as free:
            box = Box()
            await free.topics.subscribe_raw(CLAMPED, box)
            await until(lambda: box.messages == [FAST], within=20)
        assert not [each for each in publisher.links if each.stream.peer.name == "/robot"]


async def test_a_restricted_reader_is_restricted_by_the_true_definition(site: Site) -> None:
    async with site.node("/forwarder") as forwarder, site.node("/robot") as robot:
        await forwarding(forwarder, TRUE.definition)
        subscriber = await robot.subscriber(CLAMPED, TWIST)
        assert await anext(subscriber.raw()) == SLOWED


class Refusing(Box):
    """Notes why it is connected to nobody."""

    def __init__(self) -> None:
        super().__init__()
        self.reasons: list[str] = []

    def refused(self, error: Exception) -> None:
        self.reasons.append(str(error))


async def test_a_type_that_this_host_does_not_know_is_not_read_by_the_senders_word(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Else a clamp that protects a robot would look where the sender says the speed is."""
    drive = TRUE.definition
    package = tmp_path / "acme" / "msg"
    package.mkdir(parents=True)
    (package / "Drive.msg").write_text(drive.partition("=" * 80)[0])
    lie = drive.replace("Vector3 linear", "Vector3[0] linear").replace(
        "Vector3 angular", "Vector3[2] angular"
    )
    md5sum = layout.parse("acme/Drive", drive).md5
    assert layout.parse("acme/Drive", lie).md5 == md5sum
    site = Site(tmp_path / "site")
    site.publish("/forwarder", CLAMPED)
    site.subscribe("/robot", CLAMPED, restriction=Restriction("acme/Drive", (), CLAMP))
    async with site.running(), site.node("/forwarder") as forwarder, site.node("/robot") as robot:
        for text, heard in ((drive, [SLOWED]), (lie, [])):
            made = await forwarder.topics.publish_raw(CLAMPED, "*", lambda: None, queue_size=10)
            made.describe(Definition("acme/Drive", md5sum, text))
            made.forward("mallory", FAST, keep=True)
            monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
            assert await read_by(robot, "is not known on this host") == []
            monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path))
            assert await read_by(robot, "" if heard else "is not the one this host knows") == heard
            await forwarder.topics.unpublish(made)


async def read_by(node: Node, refusal: str) -> list[bytes]:
    """What a node receives; with `refusal`, until it is refused for that reason."""
    box = Refusing()
    subscription = await node.topics.subscribe_raw(CLAMPED, box)
    await until(lambda: bool(box.reasons if refusal else box.messages), within=20)
    await subscription.close()
    assert refusal in "".join(box.reasons)
    return box.messages
