"""The border router: its UDP socket, its own node, the things it serves, and a ROS node for each. A shell.

Only its own node has a session with the master. What that learns of revocations holds for all things at
once: a thing whose statement or key is revoked ends here, with every connection of its node, as soon as
the list arrives. A thing gets its node when it registers.
"""

import asyncio
import contextlib
import errno
import json
import logging
import secrets
import socket
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any, Final

from aiocoap.numbers import codes

from ca.certificates import Identity
from ca.errors import CAError, HintedError
from rossec import clock, files
from rossec.border import constrained_node, conversations, handshakes, messages, resources
from rossec.border.bridge import Roster, ThingBridge
from rossec.border.endpoint import CoapAnswer, CoapEndpoint, CoapRequest, Events, OnAnswer, Served
from rossec.errors import ConfigurationError, ThingUnreachable
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.node.node import Node
from rossec.participant.renewals import prove
from rossec.ros.xmlrpc import Fault
from rossec.saved_statements import ThingFiles

PORT: Final = 5683
_READS: Final = 1024  # datagrams in one turn of the loop: 2 us each
_STRANGERS: Final = 8  # datagrams of strangers in one turn: up to 0.2 ms each
_BUFFER: Final = 4 << 20
_RCVBUFFORCE: Final = 33  # socket(7): beyond the limit of the system, for who may
SILENT: Final = 90_000.0  # seconds until a thing that sends nothing is gone (RFC 9176: 25 hours)
UPDATE_PERIOD: Final = 60  # seconds between visits of a thing's node that wants for a grant
CHECKED: Final = 16  # parts of the things: one of them is looked at each second
WELL_KNOWN: Final = (".well-known", "core")
_log = logging.getLogger("rossec.border")
STATUS_FILE: Final = "border.status"
STATUS_PERIOD: Final = 5.0  # seconds between two of them
STATUS_OLD: Final = 20  # seconds after which nobody writes it any more
MAX_STATUS: Final = 4 * 1024 * 1024


class Server:
    """Serves things at one UDP address; `host`: `::` for everywhere, IPv4 as well.

    What the network does not take is lost, as any datagram may be; things and router repeat.
    """

    def __init__(
        self, own: handshakes.StaticKey, served: Served, events: Events, host: str = "::", port: int = PORT
    ) -> None:
        self._loop = asyncio.get_running_loop()
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        # Without SO_REUSEPORT: nobody else on this host may take a part of its datagrams.
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            if family == socket.AF_INET6:
                sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, host != "::")
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER)
            with contextlib.suppress(PermissionError):
                sock.setsockopt(socket.SOL_SOCKET, _RCVBUFFORCE, _BUFFER)
            sock.setblocking(False)
            sock.bind((host, port))
        except OSError as error:
            sock.close()
            taken = error.errno == errno.EADDRINUSE
            raise ConfigurationError(
                f"cannot listen at {host} port {port} (UDP): {error.strerror}",
                "another border router runs there" if taken else "see --listen",
            ) from error
        self._socket = sock
        dice = secrets.SystemRandom().random
        self.endpoint: Final = CoapEndpoint(own, served, events, self._send, secrets.token_bytes, dice)
        self._timer: asyncio.TimerHandle | None = None
        self._intake = conversations.DatagramQueue()
        self._turn: asyncio.Handle | None = None
        self._loop.add_reader(self._socket.fileno(), self._read)

    @property
    def address(self) -> tuple[str, int]:
        host, port = self._socket.getsockname()[:2]
        return str(host), int(port)

    @property
    def lost(self) -> int:
        return self._intake.lost

    def request(self, name: str, request: CoapRequest, on_answer: OnAnswer) -> Callable[[], None] | None:
        # Returns what cancels it. None: the thing is not there.
        conversation = self.endpoint.conversations.of(name)
        if conversation is None:
            return None
        now = self._loop.time()
        exchange = self.endpoint.requests.start(conversation, request, on_answer, now)
        self._arm()
        return lambda: self.endpoint.requests.cancel(exchange)

    def drop(self, name: str) -> None:
        self.endpoint.conversations.drop(name)

    def close(self) -> None:
        self._loop.remove_reader(self._socket.fileno())
        self._socket.close()
        for handle in (self._timer, self._turn):
            if handle is not None:
                handle.cancel()

    def _read(self) -> None:
        # A lost datagram costs its thing seconds: the socket is emptied before a stranger is looked at.
        at = self.endpoint.conversations.at
        for _ in range(_READS):
            try:
                data, address = self._socket.recvfrom(messages.MAX_DATAGRAM + 1)
            except (BlockingIOError, InterruptedError):
                break
            except OSError:  # an ICMP error for what was sent before
                continue
            now, known = self._loop.time(), at(address)
            if known is None:
                self._intake.put(data, address)
            elif self._intake.is_first(address, now):
                self.endpoint.receive(data, address, now)
            else:
                known.quota.dropped += 1
        if self._turn is None:
            self._take_strangers()
        self._arm()

    def _take_strangers(self) -> None:
        # They get a part of each turn of the loop.
        self._turn = None
        for _ in range(_STRANGERS):
            taken = self._intake.take()
            if taken is None:
                break
            self.endpoint.receive(*taken, self._loop.time())
        if self._intake:
            self._turn = self._loop.call_soon(self._take_strangers)
        self._arm()

    def _send(self, data: bytes, address: messages.Address) -> None:
        with contextlib.suppress(OSError):
            self._socket.sendto(data, address)

    def _arm(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        due = self.endpoint.timers.next_due
        if due is not None:
            self._timer = self._loop.call_at(due, self._due)

    def _due(self) -> None:
        self._timer = None
        self.endpoint.timers.run(self._loop.time())
        self._arm()


class BorderNode(Node):
    def __init__(
        self,
        name: str,
        environ: Mapping[str, str],
        on_news: Callable[[], None],
        on_session: Callable[[], None],
    ) -> None:
        super().__init__(name, environ=environ)
        self._on_news, self._on_session = on_news, on_session

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        try:
            super().push_arrived(method, params, master)
        finally:
            self._on_news()

    def maintain(self) -> None:
        super().maintain()
        self._on_news()

    async def restore(self) -> None:
        await super().restore()
        self._on_session()

    async def prove(self) -> int:
        return await prove(self._context.call, self.access)


class BorderRouter:
    """Serves things at UDP `host` and `port` as ROS nodes of this border router, which is named `name`."""

    def __init__(
        self, name: str, key: handshakes.StaticKey, environ: Mapping[str, str], host: str, port: int = PORT
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
        self._shared: constrained_node.SharedIdentity

    async def start(self) -> None:
        node = self.node
        self.roster.reload()
        await node.__aenter__()
        self._shared = constrained_node.SharedIdentity(
            node.access.trust_status,
            node.settings,
            node.push_arrived,
            lambda: node.revocations.data,
            node.home.save_revocations,
            master=node.master_name,
        )
        self.server = Server(self._key, self.roster, self, self._host, self._port)

    async def close(self) -> None:
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
        await self.node.wait_ended()

    # --- events of the endpoint

    def registered(self, conversation: conversations.Conversation) -> None:
        name = conversation.name
        if name in self._attending:  # one at a time: a thing may say so ten times a second
            self._again.add(name)
            return
        self._attending.add(name)
        self._tasks.spawn(self._attend(name), f"{name}: registered")

    def left(self, name: str) -> None:
        self.server.drop(name)
        self._end(name, "the thing has left")

    def ended(self, conversation: conversations.Conversation) -> None:
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
        if self.server.endpoint.conversations.of(name) is None:
            return  # it left, or was ended, before its turn came
        try:
            bridge = await self._bridge(name)
            if bridge.node.is_due(clock.now()):
                await bridge.node.update()
            await bridge.follow(resources.read_links(await self._links(name), name))
        except (HintedError, OSError, TimeoutError, Fault) as error:
            _log.warning("%s: %s", name, error)

    async def _bridge(self, name: str) -> ThingBridge:
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
        node = constrained_node.ThingNode(NodeHome.of(self._root, name), self._shared, host)
        await node.start()
        bridge = ThingBridge(node, credential, partial(self.server.request, name), self._tasks)
        self.bridges[name] = bridge
        await node.update()
        return bridge

    async def _links(self, name: str) -> bytes:
        future: asyncio.Future[CoapAnswer | ThingUnreachable] = asyncio.get_running_loop().create_future()
        request = CoapRequest(codes.GET, WELL_KNOWN)
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
        for bridge in self.bridges.values():
            self._tasks.spawn(bridge.update(), f"{bridge.node.name}: registers again")

    def _news(self) -> None:
        if not hasattr(self, "server"):
            return
        if self.roster.reload():
            self._proved_for = b""
        now = clock.now()
        data = self.node.revocations.data
        if data != self._proved_for:
            self._proved_for = data
            for entry in self.roster.entries():
                with contextlib.suppress(CAError):
                    self.node.revocations.check(entry, now)
            if self.node.revocations.unproved:
                self._tasks.spawn(self._prove(), "proofs")
        for name, bridge in tuple(self.bridges.items()):
            if self.roster.is_served(name, bridge.credential):
                bridge.node.maintain(now)
            else:
                self.server.drop(name)
                self._end(name, "the thing is revoked, or is not served any more")
        self._end_silent()
        # A part of the things each second, not a thousand of them at once.
        self._tick += 1
        part = list(self.bridges.values())[self._tick % CHECKED :: CHECKED]
        for bridge in part:
            wants = len(bridge.resources) > bridge.offered and self._tick % UPDATE_PERIOD < CHECKED
            if wants or bridge.node.is_due(now):
                self._tasks.spawn(bridge.update(), f"{bridge.node.name}: update")

    def _end_silent(self) -> None:
        oldest = asyncio.get_running_loop().time() - SILENT
        for conversation in self.server.endpoint.conversations.all():
            statement = self.roster.statement(conversation.name)
            credential = b"" if statement is None else statement.credential.thumbprint
            if conversation.seen < oldest or not self.roster.is_served(conversation.name, credential):
                self.server.drop(conversation.name)
                self._end(conversation.name, "the thing is silent, or not served any more")

    def _end(self, name: str, reason: str) -> None:
        bridge = self.bridges.pop(name, None)
        if bridge is not None:
            _log.warning("%s: ended: %s", name, reason)
            bridge.node.cut(reason)
            self._tasks.spawn(bridge.close(reason), f"{name}: ended")

    async def _prove(self) -> None:
        with contextlib.suppress(HintedError, OSError, Fault):  # the session asks for the rest
            while await self.node.prove():
                pass
        self._news()


def describe_status(router: BorderRouter, now: int) -> dict[str, Any]:
    host, port = router.server.address
    counts = router.server.endpoint.counts
    things: dict[str, dict[str, Any]] = {}
    for name in router.roster.names:
        bridge, conversation = router.bridges.get(name), router.server.endpoint.conversations.of(name)
        things[name] = {"there": conversation is not None}
        if bridge is not None:
            things[name] |= {
                "offered": bridge.offered,
                "resources": len(bridge.resources),
                "received": bridge.received,
                "refused": bridge.refused,
                "over_rate": 0 if conversation is None else conversation.quota.dropped,
            }
    return {
        "at": now,
        "address": [host, port],
        "counts": {
            "datagrams": counts.datagrams,
            "refused": counts.refused,
            "over_budget": counts.over_budget,
            "handshakes": counts.handshakes,
            "derivations": counts.derivations,
            "lost": router.server.lost,
        },
        "things": things,
    }


# A file without secrets, written every few seconds: an old one shows that the router does not run.
def write_status(directory: Path, status: dict[str, Any]) -> None:
    files.replace(directory / STATUS_FILE, json.dumps(status, separators=(",", ":")).encode())


def read_status(directory: Path, now: int) -> dict[str, Any]:
    idle = ConfigurationError("no border router runs here", "start it: rossec border")
    data = files.read_own(directory / STATUS_FILE, MAX_STATUS, idle)
    try:
        status = json.loads(data)
        fresh = now - int(status["at"]) <= STATUS_OLD
    except (ValueError, KeyError, TypeError):
        raise ConfigurationError(f"{directory / STATUS_FILE} is damaged", "remove it") from None
    if not fresh:
        raise idle
    return dict(status)
