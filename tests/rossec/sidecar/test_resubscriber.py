"""Publisher updates that programs do not get from a master."""

import logging
import time

import pytest

from tests.rossec.sidecar.program import string_message
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, receive_bytes, wait_closed
from tests.support.blocked import BlockedNodes
from tests.support.witness import until


async def test_a_program_resubscribes_to_a_topic_whose_connection_ended(pair: SidecarPair) -> None:
    """Stock rospy waits for a publisherUpdate."""
    stream, source = await connect(pair)
    before = len(pair.listener.calls)
    source.abort()
    await wait_closed(stream)

    def named() -> list[object]:
        calls = pair.listener.calls[before:]
        return [params[1] for method, params in calls if method == "publisherUpdate"]

    await until(lambda: named() == ["/word"], within=20)


async def test_a_publisher_not_yet_registered_again_is_kept_for_a_grace_period(
    pair: SidecarPair, monkeypatch: pytest.MonkeyPatch
) -> None:
    """roscpp disconnects from publishers that the master does not name."""
    absent = BlockedNodes(monkeypatch)
    stream, source = await connect(pair)
    absent.names = {"/talker"}
    await pair.site.restart_master()

    def updates() -> list[tuple[object, ...]]:
        return [params for method, params in pair.listener.calls if method == "publisherUpdate"]

    await until(updates, within=30)
    assert [len(uris) for _, _, uris in updates() if isinstance(uris, list)][-1] == 1
    await source.send(string_message("still"))
    assert await receive_bytes(stream, len(string_message("still"))) == string_message("still")
    monkeypatch.setattr("rossec.participant.registrations.GRACE", 0.0)
    named = pair.listener_sidecar._agent_for("/listener").state.publisher_grace
    monkeypatch.setattr(named, "_until", 0.0)
    await until(lambda: updates()[-1][2] == [], within=30)


async def test_a_topic_without_a_grant_any_more_is_logged(
    pair: SidecarPair, caplog: pytest.LogCaptureFixture
) -> None:
    agent = pair.listener_sidecar._agent_for("/listener")
    agent._resubscriber.on_topic_ended("/secret", time.monotonic())
    assert "/listener: no grant for subscribe on /secret any more" in caplog.text


async def test_a_resubscription_fails_without_a_master(
    pair: SidecarPair, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.INFO)
    _, source = await connect(pair)
    assert pair.site.master is not None
    await pair.site.master.close()
    source.abort()
    await until(lambda: "/listener: cannot subscribe again: /word" in caplog.text, within=20)
