"""Open connections: checked when they begin; bugs are not hidden when they end."""

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


class FakeStream:
    """A connection that records why it was closed."""

    def __init__(self, setup: AgentSetup) -> None:
        self.peer = setup.identity("/viewer")
        self.reasons: list[str] = []

    def abort(self, reason: str) -> None:
        self.reasons.append(reason)


def make_connections(site: Site) -> tuple[PeerConnections, Any, Any]:
    """The connections of /robot, a connection of /viewer, and the decision that admitted it."""
    setup = AgentSetup(site)
    site.subscribe("/viewer", "/word")
    grants = setup.access("/viewer").present(Right.SUBSCRIBE, "/word", site.now())
    access = setup.access("/robot")
    decision = access.authorize(
        setup.identity("/viewer"), grants, Right.SUBSCRIBE, "/word", site.now()
    )
    return PeerConnections(access._revocations), FakeStream(setup), decision


def test_a_connection_is_registered_while_it_is_open(setup: AgentSetup) -> None:
    connections, stream, decision = make_connections(setup.site)
    with connections.track(stream, decision):
        (connection,) = connections
        assert connection.ends == min(decision.expires, stream.peer.not_after)
        connections.abort("enough")
    assert stream.reasons == ["enough"]
    assert list(connections) == []


def test_a_connection_that_has_expired_meanwhile_is_refused(
    setup: AgentSetup, monkeypatch: pytest.MonkeyPatch
) -> None:
    connections, stream, decision = make_connections(setup.site)
    monkeypatch.setattr("rossec.clock.HOST", Clock(lambda: decision.expires))
    with pytest.raises(HangUp, match="expired"), connections.track(stream, decision):
        pytest.fail("it began")
    assert list(connections) == []


async def test_an_expired_grant_ends_only_the_block(
    setup: AgentSetup, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    connections, stream, decision = make_connections(setup.site)

    async def expire() -> None:
        raise GrantExpired("the grant has expired")

    with connections.track(stream, decision):
        async with asyncio.TaskGroup() as group:
            group.create_task(expire())
    assert "the grant has expired" in caplog.text
    with pytest.raises(ExceptionGroup), connections.track(stream, decision):
        raise ExceptionGroup("mistakes are not hidden", [ArithmeticError()])
    assert list(connections) == []
