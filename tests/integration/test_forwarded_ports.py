"""Publishers that only a forwarded port reaches, as behind a relay: of every form, followed by every form.

The publishers register and answer an address of their own network, where nothing of theirs is.
"""

import asyncio
import contextlib
import itertools
import sys
from collections.abc import AsyncIterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import pytest
import pytest_asyncio

from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.ros.names import MASTER, PORTS, build_uri, parse_uri
from tests.integration.sidecarworld import ROSSEC, Running
from tests.support.attacker import call, credentials
from tests.support.fleet import SECURE, environment
from tests.support.forwarded_ports import ForwardedPort, forwarded_port
from tests.support.kinds import KINDS, SPEAKERS, command
from tests.support.site import Site
from tests.support.witness import until

pytestmark = [pytest.mark.ros, pytest.mark.timeout(120), pytest.mark.asyncio(loop_scope="module")]
ELSEWHERE: Final = "192.0.2.1"  # TEST-NET-1 (RFC 5737)
PAIRS: Final = tuple(itertools.product(KINDS, KINDS))
_ROSPY: Final = """
import sys, rospy
from std_msgs.msg import String
rospy.init_node(f"{sys.argv[1]}_listener")
def say(message):
    sys.stdout.write(f"HEARD {message.data}\\n")  # at once: several threads speak
    sys.stdout.flush()
for topic in sys.argv[2:]:
    rospy.Subscriber(topic, String, say)
print("READY", flush=True)
rospy.spin()
"""
_BUILTIN: Final = """
import asyncio, sys
from rossec.node import Node
async def say(subscriber):
    async for message in subscriber:
        print("HEARD", message.data, flush=True)
async def main(kind, *topics):
    async with Node(f"/{kind}_listener") as node, asyncio.TaskGroup() as group:
        for topic in topics:
            group.create_task(say(await node.subscriber(topic, "std_msgs/String")))
        print("READY", flush=True)
asyncio.run(main(*sys.argv[1:]))
"""
LISTENERS: Final[Mapping[str, str]] = {"inprocess": SECURE + _ROSPY, "builtin": _BUILTIN, "sidecar": _ROSPY}


@dataclass(frozen=True)
class Cast:
    """The forwarded ports of the publishers, the ports each told a relay, and who listens."""

    site: Site
    forwarded_ports: Mapping[str, ForwardedPort]
    listeners: Mapping[str, Running]


def api_of(site: Site, name: str) -> str | None:
    """What a node has registered as its slave API."""
    assert site.master is not None
    nodes = site.master.state.registry.nodes()
    return next((node.uri for node in nodes if node.name == name), None)


async def registered(site: Site, name: str) -> str:
    await until(lambda: api_of(site, name) is not None, within=30)
    return str(api_of(site, name))


async def named(site: Site, kind: str, uri: str) -> None:
    """The master names this slave API to all who subscribe, as it does those of other sites."""
    assert site.master is not None
    speaker = f"/{kind}_speaker"
    own = credentials(site, speaker)
    for method, *params in (
        ("rossec.presentGrants", site.enroll(speaker).grants()),
        ("registerPublisher", f"/{kind}/latched", "std_msgs/String", uri),
    ):
        answer = await call(site.master.uri, own, str(method), speaker, *params)
        assert isinstance(answer, list)
        assert answer[0] == 1, answer


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def cast(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Cast]:
    directory: Path = tmp_path_factory.mktemp("forwarded_ports")
    site = Site(directory / "site")
    for kind in KINDS:
        site.publish(f"/{kind}_speaker", f"/{kind}/*")
        site.grant(f"/{kind}_speaker", Right.PROVIDE, f"/{kind}/*")
        site.subscribe(f"/{kind}_listener", "/*/latched")
    relay = credentials(site, "/relay")
    async with site.running(), contextlib.AsyncExitStack() as stack:

        def start(kind: str, source: str, *more: str, **env: str) -> Running:
            line = tuple(command(kind, sys.executable, ROSSEC, source, *more))
            running = Running(line, environment(site, directory, **env))
            stack.push_async_callback(asyncio.to_thread, running.close)
            return running

        topics = [f"/{kind}/latched" for kind in KINDS]
        for kind in KINDS:
            start(kind, SPEAKERS[kind], ROS_IP=ELSEWHERE)
        listeners = {kind: start(kind, LISTENERS[kind], *topics) for kind in KINDS}
        forwarded_ports = {}
        for kind in KINDS:
            uri = await registered(site, f"/{kind}_speaker")
            assert parse_uri(uri)[0] == ELSEWHERE
            answer = await call(uri, relay, PORTS, "/relay")
            assert isinstance(answer, list)
            assert answer[0] == 1, answer
            forwarded_ports[kind] = stack.enter_context(forwarded_port(parse_uri(uri)[1], *answer[2]))
        for kind, listener in listeners.items():
            await asyncio.to_thread(listener.wait_for, "READY")
            await named(site, kind, forwarded_ports[kind].uri)
        yield Cast(site, forwarded_ports, listeners)


@pytest.mark.parametrize(("source", "sink"), PAIRS, ids=[f"{source}-to-{sink}" for source, sink in PAIRS])
async def test_a_topic_is_followed_at_the_forwarded_port(cast: Cast, source: str, sink: str) -> None:
    listener = cast.listeners[sink]
    await until(lambda: f"HEARD {source} kept\n" in listener.said, within=30)
    opened = cast.forwarded_ports[source].opened
    assert {WireProtocol.HTTP, WireProtocol.TCPROS} == set(opened)


async def test_every_form_comes_back_to_the_same_forwarded_port(cast: Cast) -> None:
    """The other site was out of reach, and the master had nothing new to tell."""
    every = [(each, f"HEARD {kind} kept\n") for each in cast.listeners.values() for kind in KINDS]

    def count() -> int:
        return min(listener.said.count(words) for listener, words in every)

    await until(lambda: count() == 1, within=30)
    for found in cast.forwarded_ports.values():
        found.cut()
    await asyncio.sleep(3)  # the first attempts fail
    assert count() == 1
    for found in cast.forwarded_ports.values():
        found.away = False
    await until(lambda: count() == 2, within=60)


@pytest.mark.parametrize("kind", KINDS)
async def test_only_a_relay_is_told_the_ports(cast: Cast, kind: str) -> None:
    uri = build_uri(*parse_uri(cast.forwarded_ports[kind].uri))
    for name in ("/eve", MASTER):
        answer = await call(uri, credentials(cast.site, name), PORTS, name)
        assert isinstance(answer, list)
        assert answer[:2] == [-1, f"rossec: {PORTS} is for a relay alone"]
