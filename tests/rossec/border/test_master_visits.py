"""Visits to the master."""

import asyncio

import pytest

from grants.model import Right
from rossec import clock
from rossec.border import constrained_node
from rossec.border.constrained_node import quietly
from rossec.errors import AnswerRefused, ConfigurationError, RossecError
from tests.rossec.border.test_thing_node import thing_node
from tests.support.border import LAMP
from tests.support.site import HOUR, Site
from tests.support.witness import until


async def test_calls_at_a_time_share_a_connection(site: Site) -> None:
    async with thing_node(site) as node:
        visits = node._visits
        calls = [visits.call("getPid") for _ in range(5)]
        assert len(set(map(str, await asyncio.gather(*calls)))) == 1
        client = visits._client
        await visits.call("getPid")
        assert visits._client is client
        with pytest.raises(AnswerRefused):
            await visits.call("registerPublisher", "/x", "std_msgs/String", "http://127.0.0.1:1/")


async def test_a_connection_in_use_is_not_closed(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(constrained_node, "IDLE", 0.01)
    async with thing_node(site) as node:
        visits = node._visits
        await visits.call("getPid")
        visits._used += 1
        await asyncio.sleep(0.1)
        assert visits.is_open
        visits._used -= 1
        await until(lambda: not visits.is_open)
        await visits.present([b"nobody is there"])


async def test_who_is_not_the_master_is_not_called(site: Site) -> None:
    async with thing_node(site) as node:
        object.__setattr__(node._shared, "master", "/master/other")
        with pytest.raises(ConfigurationError, match="/master answers"):
            await node._visits.call("getPid")


async def test_grants_are_renewed_when_they_are_due(site: Site) -> None:
    site.delegate()
    assert site.master is not None
    await site.restart_master()
    site.grant(LAMP, Right.PUBLISH, f"{LAMP}/**", lifetime=60, cap=HOUR, begin=site.now() - 600)
    async with thing_node(site) as node:
        assert node._visits.renewal_is_due(clock.now())
        assert await node._visits.update() == 1
        assert not node._visits.renewal_is_due(clock.now())


async def test_quietly(caplog: pytest.LogCaptureFixture) -> None:
    async def fail() -> None:
        raise RossecError("out of reach")

    assert await quietly(asyncio.sleep(0), "nothing")
    assert not await quietly(fail(), "the lamp")
    assert "the lamp: out of reach" in caplog.text
