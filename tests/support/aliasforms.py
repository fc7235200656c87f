"""The three forms of a node, as subscribers of a hospital's topic by its alias (`gateways`).

The built-in node and the program behind a sidecar are in this process, rospy in its own. The
program does what a stock one does with the publishers that it is told.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable, Coroutine
from pathlib import Path
from typing import Final, Protocol

import pytest

from ca.errors import HintedError
from rossec.channel.opening import WireProtocol
from rossec.host.runner import TaskSet
from rossec.node import Node, Subscriber, message_type
from rossec.ros.tcpros import FrameReader
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program as PlainProgram
from tests.rossec.sidecar.program import sidecar
from tests.support.attacker import HOST
from tests.support.fleet import SECURE, Program, environment, program
from tests.support.gateways import ALIAS, STRING, SUBSCRIBER, Sites
from tests.support.witness import until


class Form(Protocol):
    """A subscriber of the alias; `uri`: its API; `heard`: what it has received."""

    uri: str
    heard: list[str]

    def refused(self, why: str) -> bool:
        """Whether it has refused a publisher with these words."""


class BuiltIn:
    """A node of this process."""

    def __init__(self, node: Node, subscriber: Subscriber) -> None:
        self.uri, self.heard = node.uri, list[str]()
        self._subscriber = subscriber

    def refused(self, why: str) -> bool:
        return any(why in str(error) for error in self._subscriber.refusals)

    async def listen(self) -> None:
        async for message in self._subscriber:
            self.heard.append(message.data)


@contextlib.asynccontextmanager
async def built_in(sites: Sites, _: Path) -> AsyncIterator[Form]:
    async with sites.home.node(SUBSCRIBER) as node:
        form = BuiltIn(node, await node.subscriber(ALIAS, STRING))
        async with _running(form.listen()):
            yield form


VIEWER: Final = (
    SECURE
    + f"""
import rospy
from std_msgs.msg import String
rospy.init_node("viewer")
def hear(message):
    topic = message._connection_header["topic"]
    print(f"HEARD {{topic}} {{message.data}}\\n", end="", flush=True)
rospy.Subscriber("{ALIAS}", String, hear)
print("AT", rospy.get_node_uri(), flush=True)
rospy.spin()
"""
)


class Rospy:
    """A program with rospy and `rossec.secure()`."""

    def __init__(self, running: Program, uri: str) -> None:
        self.uri, self.heard = uri, list[str]()
        self._running = running

    def refused(self, why: str) -> bool:
        lines = self._running.said.splitlines()
        return any(why in line for line in lines if "cannot subscribe hospital:/ward/" in line)

    async def listen(self) -> None:
        while True:
            _, _, heard = (await self._running.read_until("HEARD ", 3600)).partition("HEARD ")
            topic, _, data = heard.partition(" ")
            assert topic == ALIAS, "the program sees the name that it asked for"
            self.heard.append(data)


@contextlib.asynccontextmanager
async def rospy(sites: Sites, directory: Path) -> AsyncIterator[Form]:
    async with program(environment(sites.home, directory / "logs"), VIEWER) as running:
        _, uri = (await running.read_until("AT ")).split()
        form = Rospy(running, uri)
        async with _running(form.listen()):
            yield form


class BehindSidecar:
    """A plain program; it connects to each publisher that it is told, and leaves none by itself."""

    def __init__(self, near: Sidecar, running: PlainProgram) -> None:
        exports = near._agent_for(SUBSCRIBER)._ingress.ports._ports
        [port] = (server.port for local, server in exports.items() if local.protocol is WireProtocol.HTTP)
        self.uri, self.heard = f"http://{HOST}:{port}/", list[str]()
        self._running, self._errors = running, list[str]()

    def refused(self, why: str) -> bool:
        return any(why in error for error in self._errors)

    async def listen(self) -> None:
        calls = self._running.calls
        async with asyncio.TaskGroup() as group:
            followed: dict[str, asyncio.Task[None]] = {}
            while True:
                await until(lambda: calls, within=3600)
                method, params = calls.pop(0)
                if method != "publisherUpdate" or not isinstance(params[2], list):
                    continue
                for uri in params[2]:
                    if uri not in followed or followed[uri].done():
                        followed[uri] = group.create_task(self._receive(uri))

    async def _receive(self, uri: str) -> None:
        try:
            stream, answer = await self._running.subscribe(uri, ALIAS)
        except (HintedError, OSError) as error:
            self._errors.append(str(error))
            return
        try:
            if "error" in answer:
                self._errors.append(answer["error"].decode())
                return
            assert answer["topic"] == ALIAS.encode(), "it sees the name that it asked for"
            await self._read(stream)
        finally:
            stream.abort("it ends")

    async def _read(self, stream: PlainStream) -> None:
        frames, kind = FrameReader(), message_type(STRING)
        with contextlib.suppress(HintedError):
            while True:
                for data in frames.feed(await stream.receive()):
                    self.heard.append(kind.deserialize(data).data)


@contextlib.asynccontextmanager
async def behind_a_sidecar(sites: Sites, _: Path) -> AsyncIterator[Form]:
    async with sidecar(sites.home) as near, PlainProgram(SUBSCRIBER, near) as running:
        await running.register("registerSubscriber", ALIAS, STRING)
        form = BehindSidecar(near, running)
        async with _running(form.listen()):
            yield form


@contextlib.asynccontextmanager
async def _running(work: Coroutine[None, None, None]) -> AsyncIterator[None]:
    tasks = TaskSet()
    tasks.spawn(work, "a subscriber")
    try:
        yield
    finally:
        await tasks.close()


Begin = Callable[[Sites, Path], contextlib.AbstractAsyncContextManager[Form]]
forms: Final = pytest.mark.parametrize(
    "begin",
    [
        pytest.param(built_in, id="built-in"),
        pytest.param(rospy, id="rospy", marks=pytest.mark.ros),
        pytest.param(behind_a_sidecar, id="sidecar"),
    ],
)
