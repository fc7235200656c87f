"""A publisher and a service whose rights are limited, and a peer that connects again and again."""

import asyncio
import contextlib
import struct
from collections.abc import AsyncIterator
from typing import Any, Final

from ca.certificates import Identity
from grants.model import Restriction, Right, filter_rules
from rossec.errors import ChannelError
from rossec.net.aio import SecureStream, connect
from rossec.node import Node, Publisher
from rossec.ros import tcpros
from rossec.ros.tcpros import FrameReader
from rossec.sidecar.loopback_port import PlainStream
from tests.support.attacker import EVE, HOST, fields_for
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import until

TOPIC: Final = "/robot/where"
SERVICE: Final = "/lamp/on"
SELDOM: Final = 0.001  # a second
ONE_MESSAGE: Final = Restriction(rate=SELDOM)
HELD: Final = Restriction(
    "std_msgs/Float64", (), filter_rules({"data": {"round": {"step": 2.0, "hysteresis": 0.5}}})
)
NEAR_A_BOUNDARY: Final = (0.9, 1.1, 0.95, 1.2, 1.05)


class Eve:
    """An attacker with one grant and any number of connections."""

    def __init__(self, site: Site, publisher: Publisher, port: int, grant: bytes) -> None:
        self.site = site
        self.publisher = publisher
        self.port = port
        self.grant = grant

    async def connect(self) -> SecureStream[Identity]:
        """One more connection; returns once the publisher has it."""
        before = len(self.publisher.links)
        stream = await connect(
            HOST, self.port, unlimited(self.site.enroll(EVE).credentials(), self.site.anchor.verify)
        )
        await stream.send(tcpros.encode(fields_for(EVE, TOPIC, [self.grant])))
        await until(lambda: len(self.publisher.links) == before + 1)
        return stream

    async def heard(self, *streams: SecureStream[Identity]) -> list[list[bytes]]:
        """All data sent to each; the publisher closes the connections."""
        links = tuple(self.publisher.links)
        await until(lambda: not any(queue._queue for queue in self.publisher.links.values()))
        for link in links:
            await link.stream.close()
        found = [(await messages(stream))[1:] for stream in streams]
        await until(lambda: not self.publisher.links)
        return found


async def messages(stream: SecureStream[Identity] | PlainStream) -> list[bytes]:
    """All units until the end; the header first."""
    frames, found = FrameReader(), []
    with contextlib.suppress(ChannelError):
        async with asyncio.timeout(60):
            while True:
                found += frames.feed(await stream.receive())
    stream.abort("done")
    return found


def number(value: float) -> bytes:
    return struct.pack("<d", value)


@contextlib.asynccontextmanager
async def publishing(site: Site, *restrictions: Restriction, latch: bool = False) -> AsyncIterator[Eve]:
    """/robot publishes numbers; Eve may subscribe under each of the restrictions."""
    site.publish("/robot", TOPIC)
    grants = [site.subscribe(EVE, TOPIC, item) for item in restrictions]
    async with site.node("/robot") as robot:
        publisher = await robot.publisher(TOPIC, "std_msgs/Float64", latch=latch)
        yield Eve(site, publisher, robot.topic_endpoint()[1], grants[0])


@contextlib.asynccontextmanager
async def lamp(site: Site, calls: list[bool]) -> AsyncIterator[Node]:
    def switch(request: Any) -> dict[str, object]:
        calls.append(request.data)
        return {"success": True}

    site.grant("/lamp", Right.PROVIDE, SERVICE)
    async with site.node("/lamp") as node:
        await node.service(SERVICE, "std_srvs/SetBool", switch)
        yield node
