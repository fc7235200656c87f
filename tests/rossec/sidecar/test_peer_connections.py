"""Live connections: judged when they begin, told apart from mistakes when they end."""

import asyncio
import logging
from typing import Any

import pytest

from grants.errors import GrantExpired
from grants.model import Right
from rossec.clock import Clock
from rossec.errors import HangUp
from rossec.sidecar.peer_connections import PeerConnections
from tests.rossec.sidecar.playbook import Stage
from tests.support.site import Site


class Ends:
    """A connection that remembers why it was cut."""

    def __init__(self, stage: Stage) -> None:
        self.peer = stage.identity("/viewer")
        self.reasons: list[str] = []

    def abort(self, reason: str) -> None:
        self.reasons.append(reason)


def setting(site: Site) -> tuple[PeerConnections, Any, Any]:
    """The links of /robot, a connection of /viewer, and why it was admitted a moment ago."""
    stage = Stage(site)
    site.subscribe("/viewer", "/word")
    shown = stage.access("/viewer").present(Right.SUBSCRIBE, "/word", site.now())
    access = stage.access("/robot")
    decision = access.authorize(
        stage.identity("/viewer"), shown, Right.SUBSCRIBE, "/word", site.now()
    )
    return PeerConnections(access._revocations), Ends(stage), decision


def test_a_link_is_known_while_it_lives(stage: Stage) -> None:
    links, stream, decision = setting(stage.site)
    with links.linked(stream, decision):
        (link,) = links
        assert link.ends == min(decision.expires, stream.peer.not_after)
        links.abort("enough")
    assert stream.reasons == ["enough"]
    assert list(links) == []


def test_what_was_revoked_meanwhile_does_not_begin(
    stage: Stage, monkeypatch: pytest.MonkeyPatch
) -> None:
    links, stream, decision = setting(stage.site)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: decision.expires))
    with pytest.raises(HangUp, match="expired"), links.linked(stream, decision):
        pytest.fail("it began")
    assert list(links) == []


async def test_a_guard_that_refuses_ends_the_block_alone(
    stage: Stage, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    links, stream, decision = setting(stage.site)

    async def expire() -> None:
        raise GrantExpired("the grant has expired")

    with links.linked(stream, decision):
        async with asyncio.TaskGroup() as group:
            group.create_task(expire())
    assert "the grant has expired" in caplog.text
    with pytest.raises(ExceptionGroup), links.linked(stream, decision):
        raise ExceptionGroup("mistakes are not hidden", [ArithmeticError()])
    assert list(links) == []
