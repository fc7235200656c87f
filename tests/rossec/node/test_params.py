"""Parameters of nodes against a real master: read, written, subscribed to, refused."""

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import (
    AnswerMalformed,
    AnswerRefused,
    ConfigurationError,
    ParameterUnset,
    RossecError,
    XmlRpcRefused,
)
from rossec.node import Node
from rossec.node.params import ParameterSubscription
from tests.support.site import Site
from tests.support.witness import until


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    async with Site(tmp_path / "site").running() as site:
        yield site


@pytest.fixture
async def robot(site: Site) -> AsyncIterator[Node]:
    for right in (Right.PARAM_GET, Right.PARAM_SET):
        site.grant("/robot", right, "/robot")
        site.grant("/robot", right, "/speed")
    async with site.node("/robot") as robot:
        yield robot


@pytest.fixture
async def viewer(site: Site) -> AsyncIterator[Node]:
    site.grant("/viewer", Right.PARAM_GET, "/robot")
    async with site.node("/viewer") as viewer:
        yield viewer


async def test_a_parameter_is_set_and_read(robot: Node) -> None:
    params = robot.params
    for value in (True, 7, 0.5, "text", b"bytes", [1, ["two"]], {"a": {"b": 1}}):
        await params.set("~value", value)
        assert await params.get("/robot/value") == value
    assert await params.get("~value/a/b") == 1
    assert await params.has("~value/a")
    assert not await params.has("~value/c")
    assert sorted(await params.names()) == ["/robot/value/a/b"]
    await params.delete("~value")
    assert not await params.has("~value")
    assert await params.names() == []


async def test_an_unset_parameter_has_no_value(robot: Node) -> None:
    with pytest.raises(ParameterUnset, match="/robot/none is not set") as caught:
        await robot.params.get("~none")
    assert "rossec param list" in caught.value.hint
    with pytest.raises(ParameterUnset):
        await robot.params.delete("~none")
    assert await robot.params.get("~none", None) is None
    assert await robot.params.get("~none", 3) == 3
    assert await robot.params.search("none") is None


async def test_a_parameter_without_the_right_is_refused(robot: Node, viewer: Node) -> None:
    await robot.params.set("~value", 1)
    with pytest.raises(AnswerRefused, match="param-set on /robot/value"):
        await viewer.params.set("/robot/value", 2)
    with pytest.raises(AnswerRefused, match="param-set"):
        await viewer.params.delete("/robot/value")
    with pytest.raises(AnswerRefused, match="param-get"):
        await viewer.params.get("/speed", 1)  # a refusal is not "unset"
    with pytest.raises(AnswerRefused, match="param-get"):
        await viewer.params.has("/speed")
    with pytest.raises(AnswerRefused, match="param-get"):
        await viewer.params.subscribe("/speed")
    with pytest.raises(XmlRpcRefused):
        await robot.params.set("~value", {1, 2})
    with pytest.raises(AnswerRefused):
        await robot.params.search("")
    assert await robot.params.get("~value") == 1


async def test_a_search_finds_the_parameter_in_the_nearest_namespace(robot: Node) -> None:
    await robot.params.set("/speed", 1)
    assert await robot.params.search("speed") == "/speed"
    await robot.params.set("~speed", 2)
    assert await robot.params.search("speed") == "/robot/speed"


async def follow(subscription: ParameterSubscription, seen: list[Any]) -> None:
    async for value in subscription:
        seen += [value]


async def test_a_subscription_yields_changes_of_a_parameter(robot: Node, viewer: Node) -> None:
    await robot.params.set("~value", 1)
    subscription = await viewer.params.subscribe("/robot/value")
    seen: list[Any] = []
    following = asyncio.ensure_future(follow(subscription, seen))
    await until(lambda: seen == [1])
    await robot.params.set("~value", 2)
    await until(lambda: seen == [1, 2])
    await robot.params.set("~value", {"x": {"y": 3}, "z": 4})
    await until(lambda: subscription.value == {"x": {"y": 3}, "z": 4})
    await robot.params.set("~value/x/y", 5)
    await until(lambda: subscription.value == {"x": {"y": 5}, "z": 4})
    await robot.params.delete("~value/x/y")
    await until(lambda: subscription.value == {"z": 4})
    await robot.params.set("/robot", {"value": 6})
    await until(lambda: subscription.value == 6)
    await robot.params.delete("/robot")
    await until(lambda: subscription.value == {})
    await subscription.close()
    await subscription.close()
    await following
    updates = subscription.updates
    await robot.params.set("~value", 7)
    second = await viewer.params.subscribe("/robot/value")
    assert second.value == 7
    assert subscription.updates == updates


async def test_a_subscription_yields_own_changes_and_ends_with_the_node(robot: Node) -> None:
    await robot.params.set("~value", 1)
    one, other = [await robot.params.subscribe(name) for name in ("~value", "/robot")]
    seen: list[Any] = []
    following = asyncio.ensure_future(follow(one, seen))
    await until(lambda: seen == [1])
    await robot.params.set("/robot", {"value": 2})
    assert (one.value, other.value) == (2, {"value": 2})
    await robot.params.set("/robot", 3)
    assert (one.value, other.value) == ({}, 3)
    twice = await robot.params.subscribe("~value")
    await twice.close()
    await robot.params.set("~value", 4)
    await until(lambda: seen[-1] == 4)
    await robot.close()
    await following
    await twice.close()


async def test_a_subscription_continues_after_a_restart_of_the_master(
    site: Site, robot: Node, viewer: Node
) -> None:
    await robot.params.set("~value", 1)
    subscription = await viewer.params.subscribe("/robot/value")
    assert subscription.value == 1
    await site.restart_master()

    async with asyncio.timeout(20):
        for pause in itertools.repeat(0.05):
            with contextlib.suppress(RossecError):
                await robot.params.set("~value", 2)
                break
            await asyncio.sleep(pause)
    await until(lambda: subscription.value == 2)
    await robot.params.set("~value", 3)
    await until(lambda: subscription.value == 3)


async def test_a_malformed_list_of_names_is_refused(robot: Node, monkeypatch: pytest.MonkeyPatch) -> None:
    async def answer(*_: object) -> object:
        return ["/a", 1]

    monkeypatch.setattr(robot._membership.session._client, "ask", answer)
    with pytest.raises(AnswerMalformed, match="not a list of str"):
        await robot.params.names()


async def test_nothing_is_set_below_remote(robot: Node) -> None:
    with pytest.raises(ConfigurationError, match="/remote/hospital/speed cannot be set here"):
        await robot.params.set("/remote/hospital/speed", 1)
    with pytest.raises(ConfigurationError, match="/remote/hospital cannot be deleted here"):
        await robot.params.delete("/remote/hospital/")
