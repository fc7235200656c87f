"""Attacks with what may be presented on an open connection: grants and certificates."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass, field
from typing import Any, Final

import pytest

from ca.encoding import encode
from grants import document
from grants.model import Restriction, Right, filter_rules
from rossec import clock
from rossec.channel.negotiation import MOST_AT_ONCE
from rossec.channel.records import MAX_GRANTS, Frame, header
from rossec.demo.intruder import accept_any
from rossec.errors import ChannelError
from rossec.net.aio import SecureStream, connect
from rossec.node import Node, Publisher
from rossec.ros import tcpros as ros_header
from rossec.ros.tcpros import FrameReader
from tests.support.attacker import EVE, HOST, credentials, fields_for
from tests.support.contexts import unlimited
from tests.support.site import DAY, Site
from tests.support.witness import until

TOPIC: Final = "/robot/word"
TYPE: Final = "std_msgs/String"
SHORT: Final = Restriction(TYPE, (), filter_rules({"data": {"truncate": {"length": 4}}}))
SHORTER: Final = Restriction(TYPE, (), filter_rules({"data": {"truncate": {"length": 2}}}))


@dataclass
class Open:
    """Eve's connection to the robot's topic, and the robot's side of it."""

    robot: Node
    publisher: Publisher
    stream: SecureStream[Any]
    frames: FrameReader = field(default_factory=FrameReader)

    @property
    def link(self) -> Any:
        [link] = self.publisher.links
        return link

    async def hears(self) -> bytes:
        """What she gets of one message."""
        self.publisher.publish(self.publisher.create(data="a secret word"))
        async with asyncio.timeout(30):
            while not (found := self.frames.feed(await self.stream.receive())):
                pass
        return found[0][4:]

    async def present(self, *grants: bytes) -> None:
        """Present these, and wait until the robot has judged them."""
        data = encode(list(grants))
        assert self.stream.present_grants(data)
        await until(lambda: self.link.presented.by_peer == data, within=30)

    async def ended(self) -> None:
        with contextlib.suppress(ChannelError):
            async with asyncio.timeout(30):
                while True:
                    await self.stream.receive()
        await until(lambda: not self.publisher.links, within=30)


@contextlib.asynccontextmanager
async def subscribed(site: Site, *grants: bytes) -> AsyncIterator[Open]:
    """Eve subscribes with these grants."""
    site.publish("/robot", TOPIC)
    own = unlimited(credentials(site), accept_any, renews=lambda *_: True)
    async with site.node("/robot") as robot:
        publisher = await robot.publisher(TOPIC, TYPE)
        stream = await connect(HOST, robot.topic_endpoint()[1], own)
        made = Open(robot, publisher, stream)
        await stream.send(ros_header.encode(fields_for(EVE, TOPIC, list(grants))))
        found: list[bytes] = []
        while not found:
            found = made.frames.feed(await stream.receive())
        assert b"error" not in found[0]
        yield made
        stream.abort("heard enough")


@pytest.mark.attack("presented-later")
async def test_a_grant_of_another_node_gives_nothing_and_prolongs_nothing(site: Site) -> None:
    own = site.subscribe(EVE, TOPIC, SHORT)
    site.enroll("/other")
    wide = site.grant("/other", Right.SUBSCRIBE, TOPIC, lifetime=2 * DAY)
    async with subscribed(site, own) as eve:
        ends = eve.link.ends
        for presented in ((wide,), (wide[:-1] + bytes([wide[-1] ^ 1]),), (b"no grant",)):
            await eve.present(*presented)
            assert await eve.hears() == b"a se"
            assert eve.link.ends == ends


@pytest.mark.attack("presented-later")
async def test_a_right_to_something_else_gives_nothing(site: Site) -> None:
    own = site.subscribe(EVE, TOPIC, SHORT)
    others = [
        site.grant(EVE, Right.SUBSCRIBE, "/robot/other"),
        site.grant(EVE, Right.PUBLISH, TOPIC),
        Site(site.root.parent / "elsewhere", "home").subscribe(EVE, TOPIC),
    ]
    async with subscribed(site, own) as eve:
        for other in others:
            await eve.present(other)
            assert await eve.hears() == b"a se"


@pytest.mark.attack("presented-later")
async def test_an_older_wider_grant_is_no_way_back(site: Site) -> None:
    """It was revoked when the narrower one replaced it."""
    wide = site.subscribe(EVE, TOPIC)
    narrow = site.subscribe(EVE, TOPIC, SHORT)
    async with subscribed(site, wide) as eve:
        link = eve.link
        assert await eve.hears() == b"a secret word"
        await eve.present(wide, narrow)
        assert await eve.hears() == b"a se", "the narrower one acts at once"
        await eve.robot._membership.session.call("rossec.updateRevocations", site.revoke(wide))
        revoked = eve.robot._membership._identity.revocations
        await until(lambda: not revoked.entries.isdisjoint({document.grant_id(wide)}), within=30)
        assert await eve.hears() == b"a se", "what is left of what she presented goes on"
        await eve.present(wide)
        assert await eve.hears() == b"a se"
        await eve.present(wide, narrow)
        assert eve.link is link
        await eve.robot._membership.session.call("rossec.updateRevocations", site.revoke(narrow))
        await eve.ended()


@pytest.mark.attack("presented-later")
async def test_a_narrower_grant_acts_between_two_messages_and_ends(site: Site) -> None:
    short = site.subscribe(EVE, TOPIC, SHORT)
    shorter = site.subscribe(EVE, TOPIC, SHORTER, lifetime=6)
    async with subscribed(site, short) as eve:
        link, ends = eve.link, eve.link.ends
        assert await eve.hears() == b"a se"
        await eve.present(shorter)
        assert await eve.hears() == b"a "
        assert eve.link is link
        assert eve.link.ends < ends, "it ends with what was presented last"
        await eve.ended()


@pytest.mark.attack("presented-flood")
async def test_a_flood_of_presentations_ends_its_own_connection(site: Site) -> None:
    own = site.subscribe(EVE, TOPIC, SHORT)
    async with subscribed(site, own) as eve:
        for number in range(MOST_AT_ONCE + 1):
            eve.stream.present_grants(encode([b"%d" % number]))
        await eve.ended()


@pytest.mark.attack("presented-flood")
async def test_grants_that_are_too_long_are_not_even_buffered(site: Site) -> None:
    own = site.subscribe(EVE, TOPIC, SHORT)
    async with subscribed(site, own) as eve:
        eve.stream.write(header(Frame.GRANTS, 0, MAX_GRANTS + 17))
        await eve.ended()


@pytest.mark.attack("presented-flood")
async def test_more_grants_than_a_header_may_have_are_refused(site: Site) -> None:
    own = site.subscribe(EVE, TOPIC, SHORT)
    async with subscribed(site, own) as eve:
        await eve.present(*([own] * 17))
        assert await eve.hears() == b"a se"


@pytest.mark.attack("other-certificate")
async def test_only_her_own_certificate_renewed_takes_the_place(site: Site) -> None:
    """Not another node's, not one for her key under another name, not one that is over."""
    own = site.subscribe(EVE, TOPIC, SHORT)
    site.enroll("/other")
    elsewhere = Site(site.root.parent / "elsewhere", "home")
    async with subscribed(site, own) as eve:
        before = eve.link.stream.peer
        for chain in (
            site.enroll("/other").credentials().chain,
            elsewhere.enroll(EVE).credentials().chain,
            (b"no certificate",),
        ):
            eve.stream.present_identity(chain)
            assert await eve.hears() == b"a se"
            assert eve.link.stream.peer is before
        site.renew(EVE, 2 * DAY)
        eve.stream.present_identity(site.enroll(EVE).credentials().chain)
        await until(lambda: eve.link.stream.peer is not before, within=30)
        assert eve.link.stream.peer.not_after > before.not_after
        assert await eve.hears() == b"a se"
        assert eve.link.ends > clock.now()


@pytest.mark.attack("other-certificate")
async def test_a_revoked_key_is_not_saved_by_a_renewed_certificate(site: Site) -> None:
    own = site.subscribe(EVE, TOPIC, SHORT)
    key = site.identity(EVE).thumbprint
    async with subscribed(site, own) as eve:
        site.renew(EVE, 2 * DAY)
        eve.stream.present_identity(site.enroll(EVE).credentials().chain)
        await eve.robot._membership.session.call("rossec.updateRevocations", site.revoke(key))
        await eve.ended()
