"""A plain ROS program in a few lines of asyncio, without grant or identity."""

import asyncio
import contextlib
import os
import struct
from collections.abc import AsyncIterator, Collection
from typing import Self

from rossec.channel.opening import WireProtocol
from rossec.host.callers import Callers
from rossec.net.aio.client import dial
from rossec.net.rpc.calls import RpcClient, serve_calls
from rossec.participant.handshakes import Fields
from rossec.ros import tcpros
from rossec.ros.names import parse_uri, read
from rossec.sidecar.core.layers import ListeningAddress, parse_endpoint
from rossec.sidecar.loopback_port import LoopbackPort, PlainStream
from rossec.sidecar.pump import split_header
from rossec.sidecar.server import Sidecar
from tests.support.site import Site

STRING = {"type": b"std_msgs/String", "md5sum": b"992ce8a1687cec8c8bd883ec73ca41d1"}
ANY_CALLER = Callers({os.getuid()})


def string_message(text: str) -> bytes:
    """A std_msgs/String with its length in front, as on the wire."""
    data = struct.pack("<I", len(text)) + text.encode()
    return struct.pack("<I", len(data)) + data


class Program:
    """One program: it accepts every subscriber, echoes as a service, and records its calls.

    `published`: the topics it publishes; None: any.
    """

    kind = STRING["type"]
    md5sum = STRING["md5sum"]
    definition = b"string data\n"
    latching = False

    def __init__(self, name: str, sidecar: Sidecar, published: Collection[str] | None = None) -> None:
        self.published = published
        self.name = name
        self.master_uri = sidecar.uri
        self.calls: list[tuple[str, tuple[object, ...]]] = []
        self.connections: list[PlainStream] = []
        self.headers: list[Fields] = []
        self.connected = asyncio.Event()
        self.topics = LoopbackPort(ANY_CALLER, self._serve_topic)
        self.slave = LoopbackPort(ANY_CALLER, self._serve_slave)
        self.topics.open()
        self.slave.open()

    @property
    def uri(self) -> str:
        return f"http://127.0.0.1:{self.slave.port}"

    async def ask(self, uri: str, method: str, *params: object) -> object:
        """Call a master or a slave API; the raw answer."""
        client = RpcClient(PlainStream(await dial(*parse_uri(uri), 10)), host="x")
        try:
            return await client.call(method, self.name, *params)
        finally:
            await client.close()

    async def register(self, method: str, *params: object) -> object:
        """Register with the master, which must succeed; the value."""
        answer = await self.ask(self.master_uri, method, *params, self.uri)
        assert isinstance(answer, list)
        assert answer[0] == 1, answer
        return answer[2]

    async def connect(self, endpoint: ListeningAddress, fields: Fields) -> tuple[PlainStream, Fields]:
        """Connect for TCPROS; the stream and the header of the answer."""
        stream = PlainStream(await dial(endpoint.host, endpoint.port, 10))
        await stream.send(tcpros.encode(fields | {"callerid": self.name.encode()}))
        answer, _ = await split_header(stream)
        return stream, answer

    async def subscribe(self, uri: str, topic: str) -> tuple[PlainStream, Fields]:
        """As a subscriber does: ask the publisher at `uri`, then connect to its topic port."""
        answer = await self.ask(uri, "requestTopic", topic, [["TCPROS"]])
        assert isinstance(answer, list)
        assert answer[0] == 1, answer
        _, host, port = answer[2]
        endpoint = ListeningAddress(WireProtocol.TCPROS, host, port)
        return await self.connect(endpoint, {"topic": topic.encode(), "type": b"*", "md5sum": b"*"})

    async def call(self, uri: object, service: str) -> tuple[PlainStream, Fields]:
        """Connect to a service."""
        endpoint = parse_endpoint(uri, WireProtocol.TCPROS)
        assert endpoint is not None
        return await self.connect(endpoint, {"service": service.encode(), "md5sum": b"*"})

    async def close(self) -> None:
        await self.topics.close()
        await self.slave.close()

    async def _serve_slave(self, stream: PlainStream) -> None:
        async def answer(method: str, params: tuple[object, ...], _: str) -> object:
            self.calls.append((method, params))
            if method == "requestTopic":
                if self.published is not None and params[1] not in self.published:
                    return [-1, f"Not a publisher of [{params[1]}]", []]
                return [1, "ready", ["TCPROS", "localhost", self.topics.port]]
            return [1, "", 4711]

        await serve_calls(stream, answer)

    async def _serve_topic(self, stream: PlainStream) -> None:
        fields, _ = await split_header(stream)
        self.headers.append(fields)
        answer = {
            "type": self.kind,
            "md5sum": self.md5sum,
            "message_definition": self.definition,
            "callerid": self.name.encode(),
            **({"latching": b"1"} if self.latching else {}),
        }
        await stream.send(tcpros.encode(answer))
        self.connections.append(stream)
        self.connected.set()
        with contextlib.suppress(Exception):
            while True:
                await stream.send(await stream.receive())  # a service that echoes

    async def __aenter__(self) -> Self:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()


@contextlib.asynccontextmanager
async def sidecar(site: Site, *, each: bool = True, identity: str | None = None) -> AsyncIterator[Sidecar]:
    """A sidecar of `site` in this process."""
    settings = read((), site.environ, default_name="/sidecar")
    running = Sidecar(site.root, settings, ANY_CALLER, each=each, identity=identity)
    running.start()
    try:
        yield running
    finally:
        await running.close()
