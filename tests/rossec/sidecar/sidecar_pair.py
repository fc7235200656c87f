"""Two sidecars and two plain programs in one process, and how to connect them."""

import asyncio
import contextlib
from dataclasses import dataclass

from rossec.errors import RossecError
from rossec.sidecar.loopback_port import PlainStream
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program
from tests.support.site import Site


@dataclass
class SidecarPair:
    site: Site
    talker_sidecar: Sidecar
    listener_sidecar: Sidecar
    talker: Program
    listener: Program


async def connect(pair: SidecarPair) -> tuple[PlainStream, PlainStream]:
    """Connect publisher and subscriber; returns the plain ends at subscriber and publisher."""
    await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
    uris = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
    assert isinstance(uris, list)
    stream, answer = await pair.listener.subscribe(uris[0], "/word")
    assert "error" not in answer, answer
    await pair.talker.connected.wait()
    return stream, pair.talker.connections[-1]


async def receive_bytes(stream: PlainStream, wanted: int) -> bytes:
    """At least so many bytes."""
    data = b""
    while len(data) < wanted:
        data += await stream.receive()
    return data


async def wait_closed(stream: PlainStream) -> None:
    """Wait until the stream is closed."""
    with contextlib.suppress(RossecError):
        async with asyncio.timeout(30):
            while True:
                await stream.receive()
