"""Subscribers of every form get another domain's topic from a gateway of their own, or from there.

Which it is, the master's list of publishers says; by which name and whose grants, the publisher.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Iterable
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from ca.errors import HintedError
from grants.errors import GrantForged
from grants.model import Restriction, Right, filter_rules
from grants.token import peek
from rossec.errors import ConnectionHeaderRefused, ConnectionTruncated
from rossec.node import Node, Publisher
from tests.support.aliasforms import Begin, Form, forms
from tests.support.attacker import credentials, expect_refused, fields_for, send_header
from tests.support.gateways import (
    ALIAS,
    HOSPITAL,
    ORIGIN,
    SERVED,
    STRING,
    SUBSCRIBER,
    FalsePublisher,
    Sites,
    answering,
    two_sites,
)
from tests.support.trust import newest, remove, share
from tests.support.witness import until

pytestmark = pytest.mark.timeout(120)


class CountingGateway:
    """The home's gateway, which counts."""

    def __init__(self, node: Node, publisher: Publisher) -> None:
        self.node, self.publisher, self.sent = node, publisher, 0

    async def count(self) -> None:
        while True:
            self.publisher.publish(self.publisher.create(data=f"served {self.sent}"))
            self.sent += 1
            await asyncio.sleep(0.02)


@contextlib.asynccontextmanager
async def gateway(sites: Sites) -> AsyncIterator[CountingGateway]:
    async with sites.home.node("/gateway") as node:
        counting = CountingGateway(node, await node.publisher(SERVED, STRING))
        async with asyncio.TaskGroup() as group:
            task = group.create_task(counting.count())
            try:
                yield counting
            finally:
                task.cancel()


def speaker(sites: Sites) -> FalsePublisher:
    """A true publisher of the hospital: it says "false"."""
    name = "/speaker"
    grant = sites.hospital.publish(name, ORIGIN)
    return FalsePublisher(sites.hospital.enroll(name).credentials(), answering(name, ORIGIN, grant))


async def hears(form: Form, words: str) -> None:
    """Something new arrives that begins so."""
    known = len(form.heard)
    await until(lambda: any(said.startswith(words) for said in form.heard[known:]))


async def goes_silent(form: Form, counting: CountingGateway) -> None:
    """Nothing of what is published from now on arrives."""
    await until(lambda: not counting.publisher.links)
    sent = counting.sent
    await until(lambda: counting.sent > sent + 20)
    assert f"served {sent + 10}" not in form.heard


@forms
async def test_a_subscriber_changes_between_gateway_and_origin(begin: Begin, tmp_path: Path) -> None:
    async with (
        two_sites(tmp_path) as sites,
        gateway(sites) as counting,
        begin(sites, tmp_path) as form,
        speaker(sites).listening() as there,
    ):
        # The master knows of neither, so a sidecar that asks it again is told of nobody.
        await counting.node._context.call("unregisterPublisher", SERVED, counting.node.uri)
        for _ in range(2):
            await sites.lead(form.uri, counting.node.uri)
            await hears(form, "served ")
            await sites.lead(form.uri, there)
            await hears(form, "false")
            await goes_silent(form, counting)


@forms
async def test_the_home_filters_what_its_gateway_serves(begin: Begin, tmp_path: Path) -> None:
    """The gateway is a publisher as any: the subscriber's grant by the home restricts it."""
    rules = filter_rules({"data": {"truncate": {"length": 3}}})
    restricted = Restriction(STRING, (), rules)
    async with (
        two_sites(tmp_path, restriction=restricted) as sites,
        gateway(sites) as counting,
        begin(sites, tmp_path) as form,
    ):
        await sites.lead(form.uri, counting.node.uri)
        await until(lambda: len(form.heard) > 3)
        assert set(form.heard) == {"ser"}


async def revoke(sites: Sites, counting: CountingGateway, token: bytes) -> None:
    data = sites.home.revoke(token)
    with contextlib.suppress(ConnectionTruncated):  # it was its own key
        await counting.node._membership.session.call("rossec.updateRevocations", data)


ENDS: Final = ("the gateway's grant", "the subscriber's grant", "the gateway's key", "the domain")


@pytest.mark.parametrize("what", ENDS)
@forms
async def test_what_is_served_ends_with_a_right_or_the_label(begin: Begin, tmp_path: Path, what: str) -> None:
    async with two_sites(tmp_path) as sites, gateway(sites) as counting, begin(sites, tmp_path) as form:
        await sites.lead(form.uri, counting.node.uri)
        await hears(form, "served ")
        if what == "the domain":
            remove(sites.home, "hospital")
            call = counting.node._membership.session.call
            await call("rossec.updateDomains", newest(sites.home))
        else:
            await revoke(
                sites,
                counting,
                {
                    "the gateway's grant": sites.gateway_grant,
                    "the subscriber's grant": sites.subscriber_grant,
                    "the gateway's key": sites.home.identity("/gateway").thumbprint,
                }[what],
            )
        await goes_silent(form, counting)


async def test_a_gateway_that_is_led_to_a_gateway_is_refused(tmp_path: Path) -> None:
    """It would forward in a circle. It holds every right that both authorities could give it."""
    async with two_sites(tmp_path, "/gateway/attic") as sites:
        for name in ("/gateway", "/gateway/attic"):
            sites.home.subscribe(name, "/**")
            share(sites.hospital, sites.home, name, Right.SUBSCRIBE, "/**")
        async with gateway(sites) as counting, sites.home.node("/gateway/attic") as attic:
            for node in (attic, counting.node):
                subscriber = await node.subscriber(ALIAS, STRING)
                await sites.lead(node.uri, counting.node.uri)
                refusals = subscriber.refusals
                await until(partial(_has, refusals, "/gateway refuses"))
                assert subscriber.received == 0
                await subscriber.close()


def _has(refusals: Iterable[HintedError], words: str) -> bool:
    return any(words in str(error) for error in refusals)


async def test_a_node_of_before_asks_for_the_origins_name_and_gets_nothing(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """As the release before did, led to a gateway: by the origin's grant, or by all that it has."""
    async with two_sites(tmp_path) as sites:
        sites.home.publish("/gateway", ORIGIN)
        await check_before(sites, caplog)


async def check_before(sites: Sites, caplog: pytest.LogCaptureFixture) -> None:
    async with gateway(sites) as counting:
        await counting.node.publisher(ORIGIN, STRING, latch=True)  # a topic with the same name
        own, port = credentials(sites.home, SUBSCRIBER), counting.node.topic_endpoint()[1]
        held = sites.home.enroll(SUBSCRIBER).grants()
        assert len(held) == 2
        for grants in (held, [each for each in held if peek(each).domain == HOSPITAL]):
            said = await send_header(port, own, fields_for(SUBSCRIBER, ORIGIN, grants))
            expect_refused(said, caplog, GrantForged, "not a grant of this authority")
        said = await send_header(port, own, fields_for(SUBSCRIBER, ALIAS, held))
        expect_refused(said, caplog, ConnectionHeaderRefused, "no name on the wire")
        assert counting.publisher.links == {}
