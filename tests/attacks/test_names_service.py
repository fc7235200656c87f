"""Mallory and the service that gives names: no right, slow metadata, names of others."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import pytest

from ca.errors import HintedError
from grants.model import Right
from rossec.errors import RossecError
from rossec.namespace.topic_names import CALLS, CHILDREN, DEADLINE, SERVICE, TopicNames, service_type
from rossec.naming import rule_runner
from rossec.naming.rule_runner import RuleRunner
from rossec.node import Node
from tests.rossec.namespace.test_topic_names import BOMB, SLOW
from tests.support.site import Site

RULES = rule_runner.shipped_rules()


@asynccontextmanager
async def naming(site: Site, rules: bytes = RULES, seconds: float = 1.0) -> AsyncIterator[Node]:
    """The node `/namespace`, as `rossec namespace serve` runs it."""
    site.grant("/namespace", Right.PROVIDE, SERVICE)
    async with (
        RuleRunner(rules, children=CHILDREN, seconds=seconds) as runner,
        site.node("/namespace") as node,
    ):
        names = TopicNames(runner, node.params.get)
        await node.services.provide(
            SERVICE, service_type(), names.answer, concurrency=CALLS, deadline=DEADLINE
        )
        yield node


@pytest.mark.attack("names-service")
async def test_without_the_right_nobody_is_answered(site: Site) -> None:
    site.enroll("/mallory")
    site.grant("/mallory", Right.CALL, "/other")
    kind = service_type()
    async with naming(site), site.node("/mallory") as mallory:
        with pytest.raises(RossecError):
            await mallory.client(SERVICE, kind.name)(name="x", metadata="<node/>")
        with pytest.raises(HintedError):
            await mallory.wait_for_service(SERVICE, timeout=20)


@pytest.mark.attack("names-service")
async def test_a_caller_with_slow_metadata_delays_no_other(site: Site) -> None:
    kind = service_type()
    for name in ("/mallory", "/robot"):
        site.grant(name, Right.CALL, SERVICE)
    async with (
        naming(site, SLOW, seconds=DEADLINE),
        site.node("/mallory") as mallory,
        site.node("/robot") as robot,
    ):
        slow = [
            asyncio.ensure_future(mallory.client(SERVICE, kind.name)(name="a", metadata=BOMB))
            for _ in range(40)
        ]
        async with asyncio.timeout(60):
            for _ in range(5):
                answer = await robot.client(SERVICE, kind.name)(name="a", metadata="<node/>")
                assert answer.topicname == "/fast"
        answered = [task for task in slow if task.done() and task.exception() is None]
        assert answered == []
        for task in slow:
            task.cancel()
        await asyncio.gather(*slow, return_exceptions=True)


@pytest.mark.attack("names-service")
async def test_a_name_it_gives_is_worth_nothing_without_a_grant(site: Site) -> None:
    """She is told a name of the robot's; the master does not let her publish there."""
    kind = service_type()
    site.grant("/mallory", Right.CALL, SERVICE)
    site.grant("/mallory", Right.PUBLISH, "/fleet/mallory/**")
    claim = (
        "<node><group>fleet</group><name>robot</name><topic><name>pose</name><mobile>true</mobile>"
        "</topic></node>"
    )
    async with naming(site), site.node("/mallory") as mallory:
        answer = await mallory.client(SERVICE, kind.name)(name="pose", metadata=claim)
        assert answer.topicname == "/fleet/robot/pose"
        with pytest.raises(RossecError):
            await mallory.publisher(answer.topicname, "std_msgs/String")
