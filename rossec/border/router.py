"""The border router: its own node, the things it serves, and a ROS node for each of them.

Only its own node has a session with the master. What that learns of revocations holds for all
things at once: a thing whose statement or key is revoked ends here, with every connection of its
node, as soon as the list arrives. A thing gets its node when it registers.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, Final

from aiocoap.numbers import codes

from ca.certificates import Identity
from ca.errors import CAError, HintedError
from rossec import clock
from rossec.border.bridge import ThingBridge
from rossec.border.conversations import Conversation
from rossec.border.handshakes import StaticKey
from rossec.border.links import read_links
from rossec.border.requests import Answer, Request
from rossec.border.roster import Roster
from rossec.border.server import PORT, Server
from rossec.border.shared import SharedIdentity
from rossec.border.thing_node import ThingNode
from rossec.errors import ThingUnreachable
from rossec.home import NodeHome
from rossec.net.aio.tasks import TaskSet
from rossec.node.node import Node
from rossec.participant.revocation_proofs import prove
from rossec.ros.xmlrpc import Fault
from rossec.saved_things import ThingFiles

SILENT: Final = 90_000.0  # seconds until a thing that sends nothing is gone (RFC 9176: 25 hours)
UPDATE_PERIOD: Final = 60  # seconds between visits of a thing's node that wants for a grant
CHECKED: Final = 16  # parts of the things: one of them is looked at each second
WELL_KNOWN: Final = (".well-known", "core")
_log = logging.getLogger("rossec.border")


class BorderNode(Node):
    """The border router's own node; it tells what it learns."""

    def __init__(
        self, name: str, environ: Mapping[str, str], on_news: Callable[[], None],
        on_session: Callable[[], None],
    ) -> None:  # fmt: skip
        super().__init__(name, environ=environ)
        self._on_news, self._on_session = on_news, on_session

    def revocations_arrived(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take them, and tell at once."""
        try:
            super().revocations_arrived(revocations, timestamp, master)
        finally:
            self._on_news()

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        """Take it, and tell at once."""
        try:
            super().push_arrived(method, params, master)
        finally:
            self._on_news()

    def maintain(self) -> None:
        """Once a second."""
        super().maintain()
        self._on_news()

    async def restore(self) -> None:
        """A new session: the master may have been restarted."""
        await super().restore()
        self._on_session()

    async def prove(self) -> int:
        """Ask for proofs where revocations are a tree; raises as `prove`."""
        return await prove(self._context.call, self.access)


class BorderRouter:
    """Serves things.

    Args:
        name: the node's name.
        key: for the things.
        environ: as for `Node`.
        host, port: where it listens for things.
    """

    def __init__(
        self, name: str, key: StaticKey, environ: Mapping[str, str], host: str, port: int = PORT
    ) -> None:
        self.node: Final = BorderNode(name, environ, self._news, self._session)
        self._root = self.node.home.path.parent.parent
        self.roster: Final = Roster(ThingFiles(self.node.home), self.node.revocations, clock.now)
        self.bridges: dict[str, ThingBridge] = {}
        self._key, self._host, self._port = key, host, port
        self._tasks = TaskSet()
        self._attending: set[str] = set()
        self._again: set[str] = set()
        self._proved_for = b""
        self._tick = 0
        self.server: Server
        self._shared: SharedIdentity

    async def start(self) -> None:
        """Open the session, then serve things.

        Raises:
            HintedError, OSError: the master is out of reach or refuses; it cannot listen.
        """
        node = self.node
        self.roster.reload()
        await node.__aenter__()
        self._shared = SharedIdentity(
            node.access.standing, node.settings, node.push_arrived,
            lambda: node.revocations.data, node.home.save_revocations, master=node.master_name,
        )  # fmt: skip
        self.server = Server(self._key, self.roster, self, self._host, self._port)

    async def close(self) -> None:
        """Close every node."""
        if hasattr(self, "server"):
            self.server.close()
        await self._tasks.close()
        reason = "the border router ends"
        await asyncio.gather(
            *(bridge.close(reason) for bridge in self.bridges.values()), return_exceptions=True
        )
        if hasattr(self, "_shared"):
            await self._shared.tasks.close()
        await self.node.close()

    async def wait_ended(self) -> None:
        """Wait until the router's own node ends; raises as `Node.wait_ended`."""
        await self.node.wait_ended()

    # --- events of the endpoint

    def registered(self, conversation: Conversation) -> None:
        """Find out what the thing has."""
        name = conversation.name
        if name in self._attending:  # one at a time: a thing may say so ten times a second
            self._again.add(name)
            return
        self._attending.add(name)
        self._tasks.spawn(self._attend(name), f"{name}: registered")

    def left(self, name: str) -> None:
        """A thing takes its leave."""
        self.server.drop(name)
        self._end(name, "the thing has left")

    def ended(self, conversation: Conversation) -> None:
        """Nothing is observed any more."""
        bridge = self.bridges.get(conversation.name)
        if bridge is not None:
            bridge.lost()

    async def _attend(self, name: str) -> None:
        try:
            self._again.add(name)
            while name in self._again:
                self._again.discard(name)
                await self._follow(name)
        finally:
            self._again.discard(name)
            self._attending.discard(name)

    async def _follow(self, name: str) -> None:
        """Offer what the thing has now."""
        if self.server.endpoint.conversations.of(name) is None:
            return  # it left, or was ended, before its turn came
        try:
            bridge = await self._bridge(name)
            if bridge.node.is_due(clock.now()):
                await bridge.node.update()
            await bridge.follow(read_links(await self._links(name), name))
        except (HintedError, OSError, TimeoutError, Fault) as error:
            _log.warning("%s: %s", name, error)

    async def _bridge(self, name: str) -> ThingBridge:
        """The thing's node, started if it is not."""
        statement = self.roster.statement(name)
        if statement is None:
            raise ThingUnreachable(f"{name} is not served any more")
        credential = statement.credential.thumbprint
        found = self.bridges.get(name)
        if found is not None and found.credential == credential and not found.node.closed:
            return found
        if found is not None:
            del self.bridges[name]
            await found.close("the thing has another credential")
        host, _ = self.node.topic_endpoint()
        node = ThingNode(NodeHome.of(self._root, name), self._shared, host)
        await node.start()
        bridge = ThingBridge(node, credential, partial(self._ask, name), self._tasks)
        self.bridges[name] = bridge
        await node.update()
        return bridge

    def _ask(self, name: str, request: Request, on_answer: Any) -> Callable[[], None] | None:
        return self.server.request(name, request, on_answer)

    async def _links(self, name: str) -> bytes:
        """The thing's list of resources."""
        future: asyncio.Future[Answer | ThingUnreachable] = (
            asyncio.get_running_loop().create_future()
        )
        request = Request(codes.GET, WELL_KNOWN)
        if self.server.request(name, request, future.set_result) is None:
            raise ThingUnreachable(f"{name} is not there any more")
        answer = await future
        if isinstance(answer, ThingUnreachable):
            raise answer
        if not answer.code.is_successful():
            raise ThingUnreachable(f"{name} does not say what it has: {answer.code.dotted}")
        return answer.body

    # --- news of the router's own node

    def _session(self) -> None:
        """The master may have been restarted: every node registers again."""
        for bridge in self.bridges.values():
            self._tasks.spawn(bridge.update(), f"{bridge.node.name}: registers again")

    def _news(self) -> None:
        """Once a second, and when something signed arrived."""
        if not hasattr(self, "server"):
            return
        if self.roster.reload():
            self._proved_for = b""
        self._prove()
        now = clock.now()
        for name, bridge in tuple(self.bridges.items()):
            if self.roster.is_served(name, bridge.credential):
                bridge.node.maintain(now)
            else:
                self.server.drop(name)
                self._end(name, "the thing is revoked, or is not served any more")
        self._check_conversations()
        self._tick += 1
        part = list(self.bridges.values())[self._tick % CHECKED :: CHECKED]
        for bridge in part:
            wants = len(bridge.resources) > bridge.offered and self._tick % UPDATE_PERIOD < CHECKED
            if wants or bridge.node.is_due(now):
                self._tasks.spawn(bridge.update(), f"{bridge.node.name}: update")

    def _check_conversations(self) -> None:
        """End those of things that are not served any more, or silent for very long."""
        oldest = asyncio.get_running_loop().time() - SILENT
        for conversation in self.server.endpoint.conversations.all():
            statement = self.roster.statement(conversation.name)
            credential = b"" if statement is None else statement.credential.thumbprint
            silent = conversation.seen < oldest
            if silent or not self.roster.is_served(conversation.name, credential):
                self.server.drop(conversation.name)
                self._end(conversation.name, "the thing is silent, or not served any more")

    def _end(self, name: str, reason: str) -> None:
        bridge = self.bridges.pop(name, None)
        if bridge is not None:
            _log.warning("%s: ended: %s", name, reason)
            bridge.node.cut(reason)
            self._tasks.spawn(bridge.close(reason), f"{name}: ended")

    def _prove(self) -> None:
        """Of a new tree of revocations, learn at once which things are revoked."""
        data = self.node.revocations.data
        if data == self._proved_for:
            return
        self._proved_for = data
        now = clock.now()
        for entry in self.roster.entries():
            with contextlib.suppress(CAError):
                self.node.revocations.check(entry, now)
        if self.node.revocations.unproved:
            self._tasks.spawn(self._prove_all(), "proofs")

    async def _prove_all(self) -> None:
        with contextlib.suppress(HintedError, OSError, Fault):  # the session asks for the rest
            while await self.node.prove():
                pass
        self._news()
