"""A running master over real secure connections on loopback, a real authority and its nodes."""

import asyncio
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any

import pytest

from ca.certificates import Identity
from grants.model import Right
from rossec.errors import RossecError
from rossec.master.api.methods import TurnClock
from rossec.master.operation.config import MasterLimits
from rossec.master.rights.statements import TrustState
from rossec.master.server.effects import MasterState
from rossec.master.server.server import MasterServer
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Registry
from rossec.net.aio import SecureStream, WireProtocol, connect, serve
from rossec.net.rpc.calls import RpcClient, serve_calls
from rossec.ros.names import parse_uri
from tests.support.authority import EnrolledNode, Site
from tests.support.contexts import unlimited

T = "std_msgs/String"
EVERYTHING = {"/**": Right(255)}


class SlaveNode:
    """An enrolled node: a control connection, and a slave API that records its calls."""

    def __init__(self, world: "World", member: EnrolledNode) -> None:
        self.world = world
        self.member = member
        self.received: list[tuple[Any, ...]] = []
        self.answer: list[Any] = [1, "", 0]

    async def start(self, rights: dict[str, Right]) -> None:
        self.server = serve(
            self.handle,
            "127.0.0.1",
            0,
            unlimited(self.member.credentials, self.world.site.anchor.verify),
            WireProtocol.HTTP,
        )
        self.world.exit.push_async_callback(self.server.close)
        self.uri = f"http://127.0.0.1:{self.server.port}/"
        self.grant = self.world.site.grant(self.member, rights)
        self.client = await self.world.call_as(self.member)
        await self.ask("rossec.presentGrants", [self.grant])

    async def handle(self, stream: SecureStream[Identity]) -> None:
        await serve_calls(stream, self.dispatch)

    async def dispatch(self, method: str, params: tuple[object, ...], peer: Identity) -> object:
        self.received.append((peer.name, method, *params[1:]))
        return self.answer

    async def ask(self, method: str, *params: object) -> Any:
        return await self.client.ask(method, self.member.name, *params)

    def received_calls(self, method: str) -> list[tuple[Any, ...]]:
        return [call[2:] for call in self.received if call[1] == method]


class World:
    def __init__(self, exit_stack: AsyncExitStack) -> None:
        self.exit = exit_stack
        self.site = Site()
        self.master = self.site.enroll("/master")
        self.trust = TrustState(
            self.site.anchor, self.master.credentials.signer, self.site.revocations(), lambda _: None
        )
        self.trust.update(self.site.revoke(), self.site.now)

    async def start(self, turns: TurnClock | None = None) -> None:
        self.server = self.made(turns)
        await self.server.start()
        self.exit.push_async_callback(self.server.close)

    def made(self, turns: TurnClock | None = None, **options: Any) -> MasterServer:
        limits = options.get("limits", MasterLimits())
        imports = Imports(Registry(limits.nodes_per_identity))
        state = MasterState(name="/master", trust=self.trust, imports=imports, **options)
        return MasterServer(
            state, self.master.credentials, host="127.0.0.1", port=0, advertise="127.0.0.1", turns=turns
        )

    async def node(self, name: str, rights: dict[str, Right] = EVERYTHING) -> SlaveNode:
        node = SlaveNode(self, self.site.enroll(name))
        await node.start(rights)
        return node

    async def call_as(self, member: EnrolledNode) -> RpcClient:
        host, port = parse_uri(self.server.uri)
        stream = await connect(
            host, port, unlimited(member.credentials, self.site.anchor.verify), WireProtocol.HTTP
        )
        client = RpcClient(stream)
        self.exit.push_async_callback(client.close)
        return client


async def until(condition: Callable[[], bool]) -> None:
    async with asyncio.timeout(30):
        while not condition():  # noqa: ASYNC110 - the condition is in another task's hands
            await asyncio.sleep(0.005)


async def ends(call: Awaitable[object]) -> None:
    with pytest.raises(RossecError):
        async with asyncio.timeout(30):
            await call
