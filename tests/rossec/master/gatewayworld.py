"""A running master of a home that follows a hospital, and a gateway for it."""

from typing import Any

from grants.model import Right
from rossec.master.state.imported_facts import Site
from tests.rossec.master.visiting import VisitWorld
from tests.rossec.master.world import SlaveNode, T, until

ALIAS, SERVED = "/remote/hospital/pose", "/gateway/hospital/pose"
ORIGIN = "http://10.0.0.2:1/"
POSE = [("node", "/robot", ORIGIN), ("publisher", "/pose", "/robot"), ("type", "/pose", T)]
SERVES = {"/gateway/hospital/**": Right.PUBLISH}
MAY_BE_SERVED = {SERVED: Right.SUBSCRIBE}
NOTHING = {"/nothing": Right.SUBSCRIBE}


class ServedWorld(VisitWorld):
    """A home that follows a hospital, with a gateway for it."""

    async def start(self, *args: Any) -> None:
        await super().start(*args)
        self.server.state.imports.apply(Site("hospital", "hospital"), POSE, [])

    async def gateway(self) -> SlaveNode:
        """A gateway that serves the topic."""
        node = await self.node("/gateway", SERVES)
        await node.ask("registerPublisher", SERVED, T, node.uri)
        return node

    async def subscriber(self, name: str, *, origins: bool = False) -> tuple[SlaveNode, list[str]]:
        """A subscriber of the alias who may be served, and what it is told."""
        node = await self.node(name, MAY_BE_SERVED)
        if origins:
            await self.present_origins(node)
        return node, await node.ask("registerSubscriber", ALIAS, T, node.uri)

    async def present_origins(self, node: SlaveNode) -> bytes:
        """Let a node hold a grant of the hospital."""
        granted = self.hospital.site.grant(node.member, {"/pose": Right.SUBSCRIBE})
        await node.ask("rossec.presentGrants", [granted])
        return granted


def told(node: SlaveNode) -> list[tuple[Any, ...]]:
    return node.received_calls("publisherUpdate")


async def is_told(node: SlaveNode, *uris: str) -> None:
    await until(lambda: told(node)[-1:] == [(ALIAS, list(uris))])
