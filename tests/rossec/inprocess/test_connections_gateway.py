"""A program that subscribes to another domain's topic, of which its master names a gateway."""

from pathlib import Path

import pytest

from tests.support.aliasforms import rospy
from tests.support.gateways import SERVED, STRING, FalsePublisher, answering, two_sites
from tests.support.witness import until

pytestmark = pytest.mark.ros


async def test_a_gateway_is_asked_for_what_it_serves_and_the_program_sees_the_alias(tmp_path: Path) -> None:
    """The form checks the topic in the connection header that the program reads."""
    async with two_sites(tmp_path) as sites, sites.home.node("/gateway") as gateway:
        publisher = await gateway.publisher(SERVED, STRING, latch=True)
        publisher.publish(publisher.create(data="hello"))
        async with rospy(sites, tmp_path) as form:
            await until(lambda: form.heard == ["hello"])
            [link] = publisher.links
            assert (link.stream.peer.name, link.decision.name) == ("/viewer", SERVED)


async def test_a_publisher_that_is_listed_no_longer_is_left(tmp_path: Path) -> None:
    async with two_sites(tmp_path) as sites, rospy(sites, tmp_path) as form:
        grant = sites.gateway_grant
        own = sites.home.enroll("/gateway").credentials()
        publisher = FalsePublisher(own, answering("/gateway", SERVED, grant))
        async with publisher.listening() as uri:
            await sites.lead(form.uri, uri)
            await until(lambda: len(form.heard) > 3)
            assert publisher.requested == [SERVED]
            await sites.lead(form.uri, uri, "http://127.0.0.1:1/")
            heard = len(form.heard)
            await until(lambda: len(form.heard) > heard + 30)
            assert not publisher.was_left()
            await sites.lead(form.uri)
            await until(publisher.was_left)
