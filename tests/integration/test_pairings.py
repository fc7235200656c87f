"""In-process rospy, built-in nodes, and programs behind a sidecar: every pair of them.

Nine pairs for topics and nine for services, with the same master; what one form of rossec refuses,
closes or filters, every other one does too.
"""

import asyncio
import contextlib
import itertools
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest

from grants.model import Right
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.support.attacker import call, credentials
from tests.support.hosts import Host, Hosts
from tests.support.kinds import KINDS, LISTENERS, SEEN, SPEAKERS, command
from tests.support.site import Site, coarse

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]
BRIEF: Final = 12  # seconds
PAIRS: Final = tuple(itertools.product(KINDS, KINDS))
pairs = pytest.mark.parametrize(
    ("source", "sink"), PAIRS, ids=[f"{source}-to-{sink}" for source, sink in PAIRS]
)


@dataclass(frozen=True)
class Cast:
    """The running programs, the grants to be revoked, and the file that subscribers wait for."""

    world: World
    speakers: Mapping[str, Running]
    listeners: Mapping[str, Running]
    words: Mapping[str, bytes]
    calls: Mapping[str, bytes]
    signal: Path

    @property
    def everybody(self) -> list[Running]:
        return [*self.speakers.values(), *self.listeners.values()]

    def revoke(self, grants: Mapping[str, bytes]) -> None:
        """Revoke a grant of every subscriber; the master notifies all nodes."""
        site = self.world.site
        data = [site.revoke(grant) for grant in grants.values()][-1]
        uri = f"http://127.0.0.1:{self.world.port}/"
        own = credentials(site, "/carrier")
        answer = asyncio.run(call(uri, own, "rossec.updateRevocations", "/carrier", data))
        assert isinstance(answer, list)
        assert answer[0] == 1, answer


@pytest.fixture(scope="module")
def cast(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cast]:
    directory = tmp_path_factory.mktemp("pairings")
    loopback = Host((), "127.0.0.1", "::1")
    site = Site(directory / "site")
    world = World(Hosts(loopback, loopback, real=False), site, directory)
    signal = directory / "follow"
    words, calls = {}, {}
    for kind in KINDS:
        world.enroll(f"/{kind}_speaker", publish=f"/{kind}/*", provide=f"/{kind}/*")
        listener = f"/{kind}_listener"
        world.enroll(listener, subscribe="/*/latched")
        site.subscribe(listener, "/*/pose", coarse())
        words[kind] = site.subscribe(listener, "/*/words")
        calls[kind] = site.grant(listener, Right.CALL, "/*/switch")
    with contextlib.ExitStack() as stack:
        stack.enter_context(world.master())

        def start(kind: str, source: str, *more: str) -> Running:
            line = command(kind, sys.executable, ROSSEC, source, *more)
            return stack.enter_context(world.started(loopback, *line))

        speakers = {kind: start(kind, SPEAKERS[kind]) for kind in KINDS}
        for speaker in speakers.values():
            speaker.wait_for("READY")
        told = " ".join(KINDS), str(signal)
        listeners = {kind: start(kind, LISTENERS[kind], *told) for kind in KINDS}
        yield Cast(world, speakers, listeners, words, calls, signal)


@pairs
def test_messages_arrive_at_every_kind_of_subscriber(cast: Cast, source: str, sink: str) -> None:
    cast.listeners[sink].wait_for(f"HEARD {source} words {source} ")


@pairs
def test_a_late_subscriber_gets_the_latched_message(cast: Cast, source: str, sink: str) -> None:
    cast.listeners[sink].wait_for(f"HEARD {source} latched {source} kept")


@pairs
def test_publishers_filter_and_withhold(cast: Cast, source: str, sink: str) -> None:
    """Every kind of publisher applies the restriction to every kind of subscriber."""
    about = f"HEARD {source} pose "
    listener = cast.listeners[sink]
    wait(lambda: listener.said.count(about) > 5)
    poses = {line.removeprefix(about).strip() for line in listener.lines if line.startswith(about)}
    assert poses == {SEEN}


@pairs
def test_services_answer_every_kind_of_client(cast: Cast, source: str, sink: str) -> None:
    cast.listeners[sink].wait_for(f"CALLED {source} {source} answers")


@pairs
def test_persistent_services_answer_every_call(cast: Cast, source: str, sink: str) -> None:
    listener = cast.listeners[sink]
    wait(lambda: listener.said.count(f"KEPT {source} {source} answers") >= 3)
    assert "NOT KEPT" not in listener.said
    assert "NOT CALLED" not in listener.said


def test_every_kind_follows_the_end_of_a_grant(cast: Cast) -> None:
    """Granted for some seconds while the programs run; closed at both ends when it expires."""
    end = int(time.time()) + BRIEF
    for kind in KINDS:
        cast.world.site.grant(f"/{kind}_listener", Right.SUBSCRIBE, "/*/brief", lifetime=BRIEF)
    time.sleep(2.5)  # every grant directory has been read: an entry is made once
    cast.signal.touch()
    for source, sink in PAIRS:
        cast.listeners[sink].wait_for(f"HEARD {source} brief {source} ")
    for speaker in cast.speakers.values():
        wait(lambda speaker=speaker: "brief 0" in last(speaker, "LISTENERS"))  # type: ignore[misc]
    assert time.time() >= end
    _is_silent(cast, "brief")


def test_a_revoked_right_to_subscribe_closes_the_connection_at_both_ends(cast: Cast) -> None:
    before = {running: len(running.lines) for running in cast.everybody}
    cast.revoke(cast.words)
    for speaker in cast.speakers.values():
        wait(lambda speaker=speaker: "words 0" in last(speaker, "LISTENERS"))  # type: ignore[misc]
    _is_silent(cast, "words")
    for listener in cast.listeners.values():
        listener.wait_for("no grant for subscribe on ")
    _nobody_spins(before)


def test_a_new_grant_resumes_the_messages(cast: Cast) -> None:
    """Also for a program that does not reconnect itself, such as stock rospy."""
    heard = _from_now(cast)
    for kind in KINDS:
        cast.world.site.subscribe(f"/{kind}_listener", "/*/words")
    for source, sink in PAIRS:
        wait(lambda source=source, sink=sink: f"HEARD {source} words" in heard(sink))  # type: ignore[misc]


def test_a_revoked_right_to_call_closes_persistent_connections(cast: Cast) -> None:
    before = {running: len(running.lines) for running in cast.everybody}
    cast.revoke(cast.calls)
    for source, sink in PAIRS:
        cast.listeners[sink].wait_for(f"NOT CALLED {source} ")
        cast.listeners[sink].wait_for(f"NOT KEPT {source} ")
    for listener in cast.listeners.values():
        listener.wait_for("needs the right call on ")
    _nobody_spins(before)


def last(running: Running, words: str) -> str:
    return next(line for line in reversed(running.lines) if words in line)


def _is_silent(cast: Cast, topic: str) -> None:
    """While poses arrive in every pair, no message of `topic` does."""
    heard = _from_now(cast)
    for source, sink in PAIRS:
        wait(lambda source=source, sink=sink: heard(sink).count(f"HEARD {source} pose") >= 3)  # type: ignore[misc]
        assert f"HEARD {source} {topic}" not in heard(sink)


def _from_now(cast: Cast) -> Callable[[str], str]:
    """The output of the subscriber of this kind since then."""
    begins = {kind: len(listener.lines) for kind, listener in cast.listeners.items()}
    return lambda kind: "".join(cast.listeners[kind].lines[begins[kind] :])


def _nobody_spins(before: Mapping[Running, int]) -> None:
    """A refused connection is retried at growing intervals, and logged a few times at most."""
    own = ("HEARD", "CALLED", "KEPT", "NOT", "LISTENERS")
    for running, begin in before.items():
        lines = [line for line in running.lines[begin:] if not line.startswith(own)]
        assert len(lines) <= 40, "".join(lines)
