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
from tests.rossec.sidecar.agent_setup import AgentSetup
from tests.support.site import Site


class Ends:
    """A connection that remembers why it was cut."""

    def __init__(self, setup: AgentSetup) -> None:
        self.peer = setup.identity("/viewer")
        self.reasons: list[str] = []

    def abort(self, reason: str) -> None:
        self.reasons.append(reason)


def setting(site: Site) -> tuple[PeerConnections, Any, Any]:
    """The links of /robot, a connection of /viewer, and why it was admitted a moment ago."""
    setup = AgentSetup(site)
    site.subscribe("/viewer", "/word")
    shown = setup.access("/viewer").present(Right.SUBSCRIBE, "/word", site.now())
    access = setup.access("/robot")
    decision = access.authorize(
        setup.identity("/viewer"), shown, Right.SUBSCRIBE, "/word", site.now()
    )
    return PeerConnections(access._revocations), Ends(setup), decision


def test_a_link_is_known_while_it_lives(setup: AgentSetup) -> None:
    connections, stream, decision = setting(setup.site)
    with connections.track(stream, decision):
        (connection,) = connections
        assert connection.ends == min(decision.expires, stream.peer.not_after)
        connections.abort("enough")
    assert stream.reasons == ["enough"]
    assert list(connections) == []


def test_what_was_revoked_meanwhile_does_not_begin(
    setup: AgentSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    connections, stream, decision = setting(setup.site)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: decision.expires))
    with pytest.raises(HangUp, match="expired"), connections.track(stream, decision):
        pytest.fail("it began")
    assert list(connections) == []


async def test_a_guard_that_refuses_ends_the_block_alone(
    setup: AgentSetup, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    connections, stream, decision = setting(setup.site)

    async def expire() -> None:
        raise GrantExpired("the grant has expired")

    with connections.track(stream, decision):
        async with asyncio.TaskGroup() as group:
            group.create_task(expire())
    assert "the grant has expired" in caplog.text
    with pytest.raises(ExceptionGroup), connections.track(stream, decision):
        raise ExceptionGroup("mistakes are not hidden", [ArithmeticError()])
    assert list(connections) == []
