"""Several masters of one domain as processes of their own, and what is between and beside them."""

import asyncio
import contextlib
import sys
import time
from collections.abc import AsyncIterator, Iterator, Mapping, Sequence

from bench._masters import OWN, SHARED, EnrolledNode, Master, enroll, free_port, running
from ca.certificates import Identity
from ca.domains import DomainList, sign_domains
from ca.keys.signing import to_coordinates
from rossec.net.aio import SecureContext, SecureStream, WireProtocol, connect, serve
from rossec.net.rpc import RpcClient, serve_calls
from rossec.ros.names import MASTER
from tests.support.site import DAY, Site

TYPE = "std_msgs/String"
_CHUNK = 1 << 16


def enroll_masters(site: Site, names: Sequence[str]) -> None:
    """Enroll masters, and put the list that names their keys into their homes."""
    homes = [site.enroll(name) for name in names]
    for home in homes:
        home.save_revocations(site.authority.store.newest_list() or b"")
    keys = sorted(to_coordinates(site.identity(name).public_key) for name in names)
    domains = DomainList(0, 1, site.now(), site.now() + DAY, (), tuple(keys))
    data = sign_domains(site.authority.signer, domains, site.anchor.domain)
    for home in homes:
        (home.path / "domains.cose").write_bytes(data)


@contextlib.contextmanager
def master(
    site: Site, name: str = MASTER, follows: Mapping[str, tuple[str, int]] | None = None, port: int = 0
) -> Iterator[Master]:
    """A master that follows others: by label, the name and port of each."""
    port = port or free_port()
    config = site.root / f"{name.rpartition('/')[2]}.yaml"
    lines = [
        f"    {label}: {{uri: 'http://127.0.0.1:{at}', master: {other}}}\n"
        for label, (other, at) in (follows or {}).items()
    ]
    config.write_text("federation:\n  sites:\n" + "".join(lines) if lines else "log: text\n")
    environ = {
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
        "ROS_IP": "127.0.0.1",
        "ROSSEC_HOME": str(site.root),
        "ROSSEC_MASTER": name,
    }
    command = [sys.executable, "-I", "-m", "rossec", "master", "--config", str(config)]
    named = [] if name == MASTER else ["--name", name]
    with running([*command, *named], environ, port) as started:
        yield started


class Slave:
    """A node at a master: a control connection, and a slave API that notes when it was called.

    Attributes:
        updates: when `publisherUpdate` came, and with which publishers.
    """

    def __init__(self, member: EnrolledNode, client: RpcClient, uri: str) -> None:
        self.name, self.client, self.uri = member.name, client, uri
        self.updates: list[tuple[float, tuple[str, ...]]] = []
        self._updated = asyncio.Event()

    async def ask(self, method: str, *params: object) -> object:
        """A call at its master."""
        return await self.client.ask(method, self.name, *params)

    async def serve(self, stream: SecureStream[Identity]) -> None:
        """Answer the master."""
        await serve_calls(stream, self._answer)

    async def until(self, uri: str, *, named: bool) -> float:
        """When an update came whose publishers have `uri`, or have it no longer."""
        async with asyncio.timeout(30):
            while not self.updates or (uri in self.updates[-1][1]) is not named:
                self._updated.clear()
                await self._updated.wait()
        return self.updates[-1][0]

    async def _answer(self, method: str, params: tuple[object, ...], _: Identity) -> object:
        match method, params:
            case "publisherUpdate", (_, _, list() as uris):
                self.updates.append((time.perf_counter(), tuple(map(str, uris))))
                self._updated.set()
            case _:
                pass
        return [1, "", 0]


@contextlib.asynccontextmanager
async def slave(site: Site, name: str, port: int, shared: str = "") -> AsyncIterator[Slave]:
    """An enrolled node that has presented its grant; it may also publish `shared`."""
    rights = {f"{name}/**": OWN, "/**": SHARED, shared: OWN} if shared else None
    member = enroll(site, name, rights)
    context = SecureContext(member.credentials, site.anchor.verify)
    holder: list[Slave] = []

    async def handle(stream: SecureStream[Identity]) -> None:
        await holder[0].serve(stream)

    server = serve(handle, "127.0.0.1", 0, context, WireProtocol.HTTP)
    client = RpcClient(await connect("127.0.0.1", port, context, WireProtocol.HTTP), deadline=60)
    holder.append(Slave(member, client, f"http://127.0.0.1:{server.port}/"))
    try:
        await client.ask("rossec.presentGrants", member.name, [member.grant])
        yield holder[0]
    finally:
        await client.close()
        await server.close()


async def register_facts(node: Slave, count: int) -> None:
    """Have about `count` facts registered: topics with their types, of one node."""
    for number in range(count // 2):
        await node.ask("registerPublisher", f"{node.name}/t{number}", TYPE, node.uri)


class Meter:
    """Passes bytes on to a port, and counts them.

    Attributes:
        port: to connect to.
        count: bytes in both directions: payload of TCP.
        reads: how often some of them came.
        opened: when a connection was made first.
    """

    def __init__(self, to: int) -> None:
        self._to = to
        self.count = self.reads = 0
        self.opened = 0.0
        self.port = 0
        self.used = asyncio.Event()

    @contextlib.asynccontextmanager
    async def running(self) -> AsyncIterator["Meter"]:
        """Listen meanwhile."""
        server = await asyncio.start_server(self._handle, "127.0.0.1", 0)
        self.port = server.sockets[0].getsockname()[1]
        try:
            yield self
        finally:
            server.close()

    async def _handle(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.opened = self.opened or time.perf_counter()
        try:
            back, forth = await asyncio.open_connection("127.0.0.1", self._to)
        except OSError:  # nobody is there yet, which the caller shall see
            writer.close()
            return
        with contextlib.suppress(OSError):
            async with asyncio.TaskGroup() as group:
                group.create_task(self._pass(reader, forth))
                group.create_task(self._pass(back, writer))

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with contextlib.suppress(OSError):
            while data := await reader.read(_CHUNK):
                self.count += len(data)
                self.reads += 1
                self.used.set()
                writer.write(data)
                await writer.drain()
        writer.close()
