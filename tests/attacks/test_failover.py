"""A restarted master gives no node more rights: what has ended stays ended."""

from functools import partial

import pytest

from rossec import clock
from rossec.clock import Clock, counter
from rossec.node import Node
from rossec.participant.registrations import GRACE
from tests.support.blocked import BlockedNodes
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, until


class Ahead:
    """A clock of this process that runs ahead, so that no test waits."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.seconds = 0.0
        count = counter()
        host = clock.HOST
        monkeypatch.setattr(
            clock, "HOST", Clock(lambda: host.time() + self.seconds, lambda: count() + self.seconds)
        )


def _is_another(node: Node, before: object) -> bool:
    return node._membership.session._stream is not before


@pytest.mark.attack("reset-sessions")
async def test_resetting_sessions_does_not_extend_a_registration(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The publisher is no longer registered; its accomplice breaks the viewer's sessions."""
    absent, ahead = BlockedNodes(monkeypatch), Ahead(monkeypatch)
    site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        pose, sight = await robot.publisher(TOPIC, POSE), await viewer.subscriber(TOPIC, POSE)
        await until(lambda: pose.links and sight.links)
        absent.names, session = {"/robot"}, viewer._membership.session._stream
        await site.restart_master()
        for _ in range(4):
            await until(partial(_is_another, viewer, session))
            session = viewer._membership.session._stream
            assert session is not None
            ahead.seconds += GRACE / 4
            session.abort("an attacker resets it")
        await until(lambda: not sight._tasks)
        await until(lambda: not sight.links)
        await until(lambda: not pose.links)


@pytest.mark.attack("reset-sessions")
async def test_a_publisher_that_is_not_named_is_still_authorized(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its right ends while the master does not name it."""
    absent = BlockedNodes(monkeypatch)
    right = site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        pose, sight = await robot.publisher(TOPIC, POSE), await viewer.subscriber(TOPIC, POSE)
        await until(lambda: pose.links and sight.links)
        absent.names = {"/robot"}
        await site.restart_master()
        await until(lambda: viewer.topics._grace._missing)
        [link] = sight.links
        await viewer._membership.session.call("rossec.updateRevocations", site.revoke(right))
        await until(lambda: link not in sight.links)
        assert viewer.topics._grace.to_follow(TOPIC) == [robot.uri]
