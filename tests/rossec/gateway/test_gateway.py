"""What a gateway serves, by a graph and rights in memory: begun, ended, begun again."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from types import SimpleNamespace
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import AnswerRefused
from rossec.gateway import gateway as module
from rossec.gateway.gateway import Gateway, Obstacle, status
from rossec.gateway.rules import TypeChanged, rule
from rossec.participant.access import possible_names
from rossec.participant.delivery_options import DeliveryOptions
from rossec.participant.registrations import WATCH_GRAPH, Retry
from tests.rossec.gateway.doubles import INT8, Topics, source
from tests.support.witness import until

RULES = [
    rule("ada", "/robot/**", DeliveryOptions()),
    rule("ben", "/**", DeliveryOptions(rate=2, newest=True)),
]
NONE = Obstacle("")
POSE, SERVED = "/remote/ada/robot/pose", "/gateway/ada/robot/pose"


class Access:
    """Rights by name; those on the origin's are held by their aliases."""

    def __init__(self) -> None:
        self.master = "/master"
        self.rights = {(Right.GRAPH, "/master"), (Right.PUBLISH, SERVED), (Right.SUBSCRIBE, POSE)}

    def current(self, _now: int) -> list[Any]:
        return sorted(name for _, name in self.rights)

    def holds(self, right: Right, name: str, now: int) -> bool:
        names = possible_names(name) if right is Right.SUBSCRIBE else (name,)
        return any(self.covers(right, each, now) for each in names)

    def covers(self, right: Right, name: str, _now: int) -> bool:
        return (right, name) in self.rights

    def is_master(self, peer: str) -> bool:
        return peer == "/master"


class Node:
    """A node whose master answers with the graph that it is told."""

    name = "/gateway"

    def __init__(self) -> None:
        self.access = Access()
        self.topics = Topics()
        self.peer = "/master"
        self.aborted = ""
        self.facts: list[list[str]] = []
        self.version = 0
        self.out_of_reach = False

    async def dial_watch(self) -> Any:
        return SimpleNamespace(peer=self.peer, abort=lambda why: setattr(self, "aborted", why))

    def publish(self, topic: str, node: str = "/remote/ada/robot") -> None:
        self.facts.append(["publisher", topic, node])
        self.version += 1

    def withdraw(self, topic: str) -> None:
        self.facts = [each for each in self.facts if each[1] != topic]
        self.version += 1


class Master:
    """Answers as soon as something has changed."""

    def __init__(self, node: Node) -> None:
        self.node, self.told = node, -1

    async def ask(self, method: str, _caller: str, *_: object) -> object:
        await asyncio.sleep(0)
        node = self.node
        if method != WATCH_GRAPH:
            return 0
        with contextlib.suppress(AssertionError):
            await until(lambda: self.told != node.version or node.out_of_reach, within=0.2)
        if node.out_of_reach:
            raise AnswerRefused("out of reach")
        self.told = node.version
        return {
            "instance": "i",
            "version": node.version,
            "cursor": 0,
            "whole": True,
            "more": False,
            "added": node.facts,
            "removed": [],
        }

    async def close(self) -> None:
        pass


@pytest.fixture(autouse=True)
def brief(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "PERIOD", 0.05)
    monkeypatch.setattr(module, "PAUSE", 0.3)


@contextlib.asynccontextmanager
async def serving(node: Node, monkeypatch: pytest.MonkeyPatch, most: int = 1024) -> AsyncIterator[Gateway]:
    monkeypatch.setattr(module, "RpcClient", lambda _stream, **_: Master(node))
    given: Any = node
    made = Gateway(given, RULES, most)
    task = asyncio.ensure_future(made.run())
    try:
        yield made
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)
    assert node.topics.publishers == {}
    assert node.topics.open == []


async def test_what_is_granted_and_published_is_served(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.publish(POSE)
    node.publish("/remote/ada/robot/secret")
    node.publish("/remote/ben/x", "/remote/ben/n")
    node.access.rights.add((Right.SUBSCRIBE, "/remote/ben/x"))
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: SERVED in node.topics.publishers)
        told = status(gateway, "/gateway")
        assert [(row["topic"], row["state"]) for row in told["topics"]] == [("ada:/robot/pose", "idle")]
        assert [(row["topic"], row["why"]) for row in told["skipped"]] == [
            ("ada:/robot/secret", "ada has not granted /gateway to subscribe it"),
            ("ben:/x", "/gateway has no grant to publish /gateway/ben/x"),
        ]
        assert "--subscribe /robot/secret" in told["skipped"][0]["hint"]
        assert "--publish '/gateway/ben/**'" in told["skipped"][1]["hint"]
        assert told["rules"][1] == {
            "from": "ben",
            "pattern": "/**",
            "rate": 2,
            "newest": True,
            "compress": False,
        }
        assert (told["problem"], told["skipped_count"]) == ("", 2)


async def test_a_grant_that_arrives_and_one_that_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.publish(POSE)
    node.access.rights.remove((Right.SUBSCRIBE, POSE))
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: POSE in gateway.skipped)
        node.access.rights.add((Right.SUBSCRIBE, POSE))
        await until(lambda: SERVED in node.topics.publishers)
        publisher = node.topics.publishers[SERVED]
        publisher.subscribe()
        await until(lambda: len(node.topics.open) == 1)
        robot = node.topics.open[0].connect(source())
        node.access.rights.remove((Right.SUBSCRIBE, POSE))
        await until(lambda: not node.topics.publishers)
        assert publisher.was_cut
        gateway.topics.get(POSE, node.topics.subscriptions[0].receiver).received(robot, [b"late"])
        assert publisher.sent == []


async def test_an_own_grant_on_what_it_serves_is_none_of_the_origin(monkeypatch: pytest.MonkeyPatch) -> None:
    """As `--subscribe '/**'` gives one: it would replace the origin's publishers, with nothing."""
    node = Node()
    node.access.rights.remove((Right.SUBSCRIBE, POSE))
    node.access.rights.add((Right.SUBSCRIBE, SERVED))
    node.publish(POSE)
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: POSE in gateway.skipped)
        assert "ada has not granted /gateway to subscribe it" in gateway.skipped[POSE].why
        assert not node.topics.publishers


async def test_what_the_graph_lost_goes_on_while_a_publisher_is_connected(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node = Node()
    node.publish(POSE)
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: SERVED in node.topics.publishers)
        node.topics.publishers[SERVED].subscribe()
        await until(lambda: len(node.topics.open) == 1)
        robot = node.topics.open[0].connect(source())
        node.withdraw(POSE)
        await until(lambda: not gateway._observed.candidates)
        await asyncio.sleep(0.2)
        assert SERVED in node.topics.publishers
        gateway.topics[POSE].disconnected(robot)
        await until(lambda: not node.topics.publishers)
        assert node.topics.open == []


async def test_a_topic_whose_type_changed_is_begun_again(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.publish(POSE)
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: SERVED in node.topics.publishers)
        before = node.topics.publishers[SERVED]
        before.subscribe()
        await until(lambda: len(node.topics.open) == 1)
        origin = node.topics.open[0]
        gateway.topics[POSE].disconnected(origin.connect(source()))
        with pytest.raises(TypeChanged):
            origin.connect(source(INT8))
        await until(lambda: node.topics.publishers.get(SERVED, before) is not before)


async def test_a_refused_registration_is_tried_again_and_disturbs_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node = Node()
    for name in ("/robot/a", "/robot/b"):
        node.publish(f"/remote/ada{name}")
        node.access.rights |= {
            (Right.SUBSCRIBE, f"/remote/ada{name}"),
            (Right.PUBLISH, f"/gateway/ada{name}"),
        }
    node.topics.refuses.add("/gateway/ada/robot/a")
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: "no right" in gateway.skipped.get("/remote/ada/robot/a", NONE).why)
        assert list(node.topics.publishers) == ["/gateway/ada/robot/b"]
        node.topics.refuses.clear()
        await until(lambda: len(node.topics.publishers) == 2)


async def test_a_crash_of_one_topic_ends_neither_the_gateway_nor_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    node = Node()
    node.publish(POSE)
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: SERVED in node.topics.publishers)
        topic = gateway.topics[POSE]

        def crash(*_: object, **__: object) -> None:
            raise RuntimeError("a mistake")

        monkeypatch.setattr(topic.state, "step", crash)
        topic._wake.set()
        await until(lambda: "RuntimeError: a mistake" in gateway.skipped.get(POSE, NONE).why)
        await until(lambda: SERVED in node.topics.publishers)
        assert gateway.topics[POSE] is not topic


async def test_the_gateway_that_was_registered_first_serves(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.publish(POSE)
    node.publish(SERVED, "/gateway/attic")
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: gateway.skipped.get(POSE, NONE).why == "/gateway/attic serves it")
        assert node.topics.publishers == {}
        node.withdraw(SERVED)
        await until(lambda: SERVED in node.topics.publishers)
        node.publish(SERVED, "/gateway/attic")  # later, or at the same time: the lower name stays
        await asyncio.sleep(0.2)
        assert SERVED in node.topics.publishers


async def test_more_topics_than_there_is_room_for_are_named(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    for number in range(3):
        name = f"/robot/t{number}"
        node.publish(f"/remote/ada{name}")
        node.access.rights |= {
            (Right.SUBSCRIBE, f"/remote/ada{name}"),
            (Right.PUBLISH, f"/gateway/ada{name}"),
        }
    async with serving(node, monkeypatch, most=2) as gateway:
        await until(lambda: len(node.topics.publishers) == 2)
        assert gateway.skipped == {"/remote/ada/robot/t2": Obstacle("only 2 topics are served")}


async def test_an_origin_with_many_topics_holds_nobody_up(monkeypatch: pytest.MonkeyPatch) -> None:
    """It may change its graph again and again, while messages of others are to be forwarded."""
    monkeypatch.setattr(module, "BATCH", 2)
    node, judged, turns = Node(), list[int](), 0
    for number in range(20):
        node.publish(f"/remote/ada/robot/t{number}")
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: len(gateway.skipped) == 20)
        monkeypatch.setattr(gateway, "_missing_right", lambda _: judged.append(turns))
        monkeypatch.setattr(gateway, "_judged_for", None)
        while len(judged) < 20:
            turns += 1
            await asyncio.sleep(0)
    assert len(set(judged)) == 10, "two at a time"


async def test_registrations_that_the_master_ended_are_made_again(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.publish(POSE)
    async with serving(node, monkeypatch):
        await until(lambda: SERVED in node.topics.publishers)
        node.publish(SERVED, "/gateway")
        await asyncio.sleep(0.5)
        assert node.topics.restored == 0
        node.withdraw(SERVED)
        await until(lambda: node.topics.restored == 1)


async def test_what_is_known_stays_while_the_master_is_out_of_reach(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.publish(POSE)
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: SERVED in node.topics.publishers)
        node.out_of_reach = True
        await until(lambda: gateway.problem)
        assert SERVED in node.topics.publishers
        node.out_of_reach = False
        await until(lambda: not gateway.problem)


async def test_a_gateway_that_may_not_see_the_graph_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.access.rights.remove((Right.GRAPH, "/master"))
    node.out_of_reach = True
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: "rossec grant sign /gateway --graph" in gateway.problem)
        refused, retry = AnswerRefused("no"), Retry(lambda: 1.0)
        assert gateway._cannot_follow(refused, retry) == module.PAUSE, "not at once: it is logged"
        node.access.rights.add((Right.GRAPH, "/master"))
        assert gateway._cannot_follow(refused, retry) < module.PAUSE
        assert gateway.problem == "no"


async def test_who_answers_at_the_masters_address_must_be_the_master(monkeypatch: pytest.MonkeyPatch) -> None:
    node = Node()
    node.peer = "/eve"
    async with serving(node, monkeypatch) as gateway:
        await until(lambda: node.aborted == "not the master")
        assert gateway.problem
