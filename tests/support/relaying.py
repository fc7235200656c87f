"""A relay without an overlay: its forwarded ports lead straight to what the other site's relay is told.

`StraightRelay` is a real member of its domain and polls a real master; only what is between two
relays is missing. The called side asks its master and connects as a relay must: from an address of
its own for each remote relay.
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import Any, cast

from ca.certificates import Identity
from rossec.errors import RelayRefused, RossecError
from rossec.host.addresses import source_for
from rossec.master.state.forwarded_ports import ForwardedPort, PeerWay, Target
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect
from rossec.overlay.masters import MasterLink
from rossec.ros.names import parse_uri
from tests.support.masters import Master

_Ends = tuple[asyncio.StreamReader, asyncio.StreamWriter]


class StraightRelay:
    """The relay of a master; `peers` are others by label, with what they call this one's domain."""

    def __init__(self, master: Master, name: str = "/relay", instance: str = "one") -> None:
        self.name = name
        self.peers: dict[str, tuple[StraightRelay, str]] = {}
        self.servers: dict[Target, asyncio.Server] = {}
        self.sources: list[str] = []  # from where it has connected for others
        self._master = master
        self._home = master.site.enroll(name)
        self.link = MasterLink(
            master.name, name, instance, self._dial, cast("Any", self), lambda masters: None
        )
        self._tasks: set[asyncio.Task[Any]] = set()

    def meet(self, label: str, other: "StraightRelay", domain: str = "") -> None:
        """Know `other` as `label`; there this site's domain is called `domain`."""
        self.peers[label] = other, domain

    def start(self) -> None:
        """Poll the master."""
        self._spawn(self.link.run())

    async def stop(self) -> None:
        """End as a killed process does: every connection through it breaks."""
        for server in self.servers.values():
            server.close()
        tasks = tuple(self._tasks)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        await self.link.close()

    async def open(self, target: Target, master: str) -> ForwardedPort:
        if target.peer not in self.peers:
            raise RelayRefused(f"no peer {target.peer}", "rossec relay add")
        if target not in self.servers:
            serve = partial(self._serve, target)
            self.servers[target] = await asyncio.start_server(serve, "127.0.0.1", 0)
        host, port = self.servers[target].sockets[0].getsockname()
        return ForwardedPort(host, port)

    def release(self, target: Target, master: str) -> None:
        self.servers.pop(target).close()

    def take_dropped(self, master: str) -> tuple[Target, ...]:
        return ()

    def ways(self) -> Mapping[str, PeerWay]:
        return dict.fromkeys(self.peers, PeerWay("up", 1.5, 0, "none", len(self._tasks) - 1))

    async def reach(self, domain: str, kind: str, name: str) -> Any:
        """Connect for another relay; `domain` is what that one's is called here."""
        host, port = await self.link.target(domain, kind, name)
        source = source_for(f"/remote/{domain}/relay" if domain else "/relay/other")
        self.sources.append(source)
        return await asyncio.open_connection(host, port, local_addr=(source, 0))

    async def _serve(
        self, target: Target, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        other, domain = self.peers[target.peer]
        try:
            far = await other.reach(domain, target.kind, target.name)
        except (RossecError, OSError):
            writer.close()
            return
        await _splice((reader, writer), far)

    def _spawn(self, work: Any) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _dial(self) -> SecureStream[Identity]:
        context: SecureContext[Identity] = SecureContext(self._home.credentials(), self._home.anchor().verify)
        address = parse_uri(self._master.server.uri)
        return await connect(*address, context, WireProtocol.HTTP)


@contextlib.asynccontextmanager
async def brought_by(relay: str, port: int) -> AsyncIterator[int]:
    """A port of this host behind which `port` is, as the remote relay `relay` brings callers."""

    async def serve(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        source = source_for(relay)
        far = await asyncio.open_connection("127.0.0.1", port, local_addr=(source, 0))
        await _splice((reader, writer), far)

    server = await asyncio.start_server(serve, "127.0.0.1", 0)
    try:
        yield server.sockets[0].getsockname()[1]
    finally:
        server.close()


async def _splice(near: _Ends, far: _Ends) -> None:
    try:
        async with asyncio.TaskGroup() as both:
            both.create_task(_copy(near[0], far[1]))
            both.create_task(_copy(far[0], near[1]))
    finally:
        for _, writer in (near, far):
            writer.transport.abort()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
        writer.write_eof()


@contextlib.asynccontextmanager
async def relayed(*relays: StraightRelay) -> AsyncIterator[None]:
    """These relays poll within this context."""
    for relay in relays:
        relay.start()
    try:
        yield
    finally:
        for relay in relays:
            await relay.stop()
