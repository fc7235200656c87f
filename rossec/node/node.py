"""A ROS node without ROS: topics, services and parameters over the secure channel, in asyncio.

Connects the parts: the master session, the slave API, the TCPROS server, topics and services. Decisions are
made elsewhere: `access` authorizes peers, `handshakes` checks headers, `connections` says when a connection
must end, `membership` keeps grants, identity and revocation data current.
"""

import asyncio
import logging
import os
import sys
from collections.abc import Awaitable, Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from types import TracebackType
from typing import Final, Self

from ca.certificates import Identity
from ca.errors import HintedError, RevocationsStale
from ca.names import shown
from rossec import clock
from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.channel.opening import post_quantum
from rossec.environment import own_home, own_master
from rossec.errors import AnswerMalformed, ConnectionHeaderRefused, NodeShutdown
from rossec.home import NodeHome
from rossec.host.addresses import warn_of_own_address
from rossec.net.aio import SecureContext, SecureServer, SecureStream, WireProtocol, serve
from rossec.node.context import NodeContext
from rossec.node.params import NodeParameters
from rossec.node.publisher import Publisher
from rossec.node.service import CONCURRENCY, HANDLER_DEADLINE, Handler, Service, Services
from rossec.node.service_client import CALL_DEADLINE, ServiceClient
from rossec.node.subscriber import Subscriber
from rossec.node.topics import Topics
from rossec.participant import handshakes
from rossec.participant.access import Access
from rossec.participant.authorized import memory_scope
from rossec.participant.connections import ConnectionTable, Dialer, OwnAddresses, serve_peer
from rossec.participant.delivery_options import DeliveryOptions, carried_out, requested_options
from rossec.participant.membership import LoadedIdentity, Membership
from rossec.participant.message_types import message_type
from rossec.participant.registrations import PublisherGrace
from rossec.participant.service_types import service_type
from rossec.participant.slave_api import SLAVE_CALLS, SlaveApi, check_slave_call
from rossec.ros import names, tcpros
from rossec.terminal import fail

# A peer that says nothing holds a descriptor no longer (attack `descriptors`).
HEADER_DEADLINE: Final = 5.0

_log = logging.getLogger("rossec.node")


@dataclass(eq=False)
class Listener:
    """Accepts the connections of other nodes: to the slave API, and by TCPROS to topics and services.

    A refused peer receives the error about its own grants, which reveals nothing of what this node has.
    """

    _node: NodeContext
    _secure: SecureContext[Identity]
    _publishers: Mapping[str, Publisher]
    _services: Services
    _slave: SlaveApi
    _own_addresses: OwnAddresses
    _servers: list[SecureServer[Identity]] = field(default_factory=list, init=False)

    async def start(self, address: str) -> None:
        """Listen; on loopback only when `address`, which the node registers, is loopback."""
        bind = address if names.is_loopback(address) else None
        for handler, protocol in (
            (self._serve_slave, WireProtocol.HTTP),
            (self._serve_tcpros, WireProtocol.TCPROS),
        ):
            server = serve(self._node.connections.bounded(handler), bind, 0, self._secure, protocol)
            self._servers.append(server)
            self._own_addresses.add_ports(address, server.port)
        self.slave_port, self.topic_port = (server.port for server in self._servers)

    async def close(self) -> None:
        for server in self._servers:
            await server.close()

    async def _serve_slave(self, stream: SecureStream[Identity]) -> None:
        presented: list[bytes] = []  # the grants the peer has presented on this connection
        await serve_peer(stream, partial(self._call, presented), self._node.access)

    async def _call(
        self, presented: list[bytes], method: str, params: tuple[object, ...], peer: Identity
    ) -> object:
        now = clock.now()
        authorized = False
        try:
            self._node.access.check_peer(peer, now)  # at each call: a connection may be older than the list
            match method, params:
                case names.PRESENT_GRANTS, (_, bytes() as grants):
                    presented[:] = [grants]
                    return [1, "", 0]
                case _:
                    pass
            if presented and method in SLAVE_CALLS and not self._node.access.is_master(peer):
                check_slave_call(method, peer, self._node.name, presented[0], self._node.access, now)
                authorized = True
        except RevocationsStale as error:
            if method not in names.SIGNED_UPDATES:  # one of them ends the staleness
                return _refused(peer, error)
        except HintedError as error:
            return _refused(peer, error)
        return await self._slave(method, params, peer, authorized=authorized)

    async def _serve_tcpros(self, stream: SecureStream[Identity]) -> None:
        try:
            async with asyncio.timeout(HEADER_DEADLINE):
                fields = tcpros.decode(await first_frame(stream))
            serve = await self._admit(fields, stream)  # a raw publisher has a limit of its own
        except TimeoutError:
            _log.info("%s sent no connection header", shown(stream.peer.name))
            return
        except HintedError as error:
            _log.warning("refused %s: %s (%s)", shown(stream.peer.name), error, error.hint)
            # It is about the peer's own grants: nothing of what exists here (attack `existence-oracle`).
            await stream.send(tcpros.error_header(f"rossec: {error}"))
            return
        await serve()

    async def _admit(
        self, fields: Mapping[str, bytes], stream: SecureStream[Identity]
    ) -> Callable[[], Awaitable[None]]:
        if "service" not in fields:
            now = clock.now()
            # The right before the look-up: without it a peer does not learn what is published here (N5).
            decision = handshakes.admit_subscriber(fields, stream.peer, self._node.access, now)
            topic = handshakes.requested_topic(fields)
            publisher = self._publishers.get(topic)
            if publisher is None:
                raise ConnectionHeaderRefused(f"{self._node.name} does not publish {topic}")
            options = carried_out(requested_options(fields), decision)
            await publisher.ready()
            handshakes.check_type(fields, topic, publisher.endpoint.type)
            guard = publisher.guard(decision)
            name = self._node.name_for(stream.peer)
            answer = handshakes.publisher_header(
                name, publisher.endpoint, self._node.access, now, latching=publisher.latch
            )
            head = tcpros.encode(answer | options.fields)
            return partial(publisher.serve, stream, decision, guard, head, options)
        if "topic" in fields:
            raise ConnectionHeaderRefused("the connection header asks for a topic and for a service")
        return self._services.admit(fields, stream)


def _refused(peer: Identity, error: HintedError) -> list[object]:
    _log.warning("refused %s: %s (%s)", shown(peer.name), error, error.hint)
    return [-1, f"rossec: {error}", 0]


async def first_frame(stream: SecureStream[Identity]) -> bytes:
    """The connection header, which must arrive before anything else."""
    reader = tcpros.FrameReader(tcpros.HEADER_LIMIT)
    while not (frames := reader.feed(await stream.receive())):
        pass
    if len(frames) != 1 or reader.pending:
        raise ConnectionHeaderRefused("bytes after the connection header, before its answer")
    return frames[0]


class Node:
    """One node: `async with Node("/camera") as node: ...`.

    Args:
        name: the node's name; `__name:=` and `__ns:=` in `argv` change it as in ROS. For
            `/rviz_17` an identity of `/rviz` for anonymous nodes is enough.
        argv: ROS arguments of the program (remappings and the like), without its path.
        environ: where ROS_MASTER_URI, ROS_IP and so on, ROSSEC_HOME and ROSSEC_POST_QUANTUM are
            read from.
    """

    def __init__(
        self, name: str, *, argv: Sequence[str] = (), environ: Mapping[str, str] = os.environ
    ) -> None:
        install()
        self._environ = environ
        self.settings = names.read(argv, environ, default_name=name)
        self.name = self.settings.name
        loaded = LoadedIdentity(NodeHome.find(own_home(environ), self.name), self.name, own_master(environ))
        self.master_name = loaded.master
        self.home, self.anchor, self.identity = loaded.home, loaded.anchor, loaded.identity
        self.credentials, self.revocations = loaded.live_credentials, loaded.revocations
        self.access = Access(loaded.trust_status, master=loaded.master)
        secure = SecureContext(
            self.credentials,
            loaded.anchors.verify,
            suites=post_quantum(environ),
            known=KnownCertificates(),
            renews=Identity.renews,
        )
        own_addresses = OwnAddresses()
        self._dialer = Dialer(self.name, secure, self.access.check_peer, own_addresses, self.identity.name)
        connections: ConnectionTable[SecureStream[Identity]] = ConnectionTable(
            loaded.trust_status, master=loaded.master
        )
        grace = PublisherGrace(clock.counter())
        self._membership = Membership(loaded, self.access, connections, grace, self)
        self._context = context = NodeContext(
            self.name,
            self.access,
            connections,
            self._membership.session.call,
            self._dialer,
            self.home.filter_key,
            memory_scope(self.name),
            certified=self.identity.name,
        )
        self.topics = Topics(context, grace)
        self.services = Services(context)
        self.params = NodeParameters(context, self.settings.resolve)
        slave = SlaveApi(self, loaded.master)
        self._listener = Listener(
            context, secure, self.topics.publishers, self.services, slave, own_addresses
        )
        self._host = ""
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def __aenter__(self) -> Self:
        address = self.settings.address
        try:
            warn_of_own_address(
                address,
                self._environ,
                lambda error: _log.warning("%s: %s (%s)", self.name, error, error.hint),
            )
            # The session first: the master checks a node's grants before it registers anything (0006).
            stream = await self._membership.session.open()
            self._host = address or stream.local_address
            await self._listener.start(self._host)
            self._context.uri = names.build_uri(self._host, self._listener.slave_port)
            self._context.rosrpc = names.build_uri(*self.topic_endpoint(), scheme="rosrpc")
            self._membership.start()
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def publisher(
        self, topic: str, type_name: str, *, latch: bool = False, queue_size: int = 10
    ) -> Publisher:
        """Publish messages of `type_name` on `topic`. Raises MessageError, RossecError: unknown type, a
        second publisher of the topic, or the master refuses."""
        endpoint = handshakes.TopicEndpoint(self.settings.resolve(topic), message_type(type_name))
        return await self.topics.publish(endpoint, latch=latch, queue_size=queue_size)

    async def topic_types(self) -> dict[str, str]:
        """The topics that have a publisher or subscriber, and that this node may see: their types. Raises
        RossecError: the master refuses, or is out of reach."""
        answer = await self._context.call("getTopicTypes")
        found: dict[str, str] = {}
        for row in answer if isinstance(answer, list) else [answer]:
            match row:
                case [str(topic), str(kind)]:
                    found |= {topic: kind} if kind != names.ANY_TYPE else {}
                case _:
                    raise AnswerMalformed("a list of topics that is malformed")
        return found

    async def subscriber(
        self,
        topic: str,
        type_name: str,
        *,
        queue_size: int = 10,
        rate: float | None = None,
        newest: bool = False,
        deflate: bool = False,
    ) -> Subscriber:
        """Receive messages of `type_name` on `topic`: `async for message in subscriber`.

        What each publisher is asked for: at most `rate` messages a second, of those that wait for a slow line
        only the `newest`, messages that are compressed (`deflate`). Raises MessageError, RossecError: unknown
        type, a wrong rate, or the master refuses.
        """
        options = DeliveryOptions(rate, newest, deflate)
        endpoint = handshakes.TopicEndpoint(self.settings.resolve(topic), message_type(type_name))
        return await self.topics.subscribe(endpoint, queue_size=queue_size, options=options)

    async def service(
        self,
        name: str,
        type_name: str,
        handler: Handler,
        *,
        concurrency: int = CONCURRENCY,
        deadline: float = HANDLER_DEADLINE,
    ) -> Service:
        """Provide the service `name`: `handler(request)` returns the response; see `Service`. Raises
        MessageError, RossecError: unknown type, a second provider of the service, or the master refuses."""
        return await self.services.provide(
            self.settings.resolve(name),
            service_type(type_name),
            lambda request, _: handler(request),
            concurrency=concurrency,
            deadline=deadline,
        )

    def client(
        self, name: str, type_name: str, *, persistent: bool = False, deadline: float = CALL_DEADLINE
    ) -> ServiceClient:
        """Call the service `name`: `response = await client(data=True)`; see `ServiceClient`. Raises
        MessageError: unknown type."""
        return self.services.client(
            self.settings.resolve(name), service_type(type_name), persistent=persistent, deadline=deadline
        )

    async def wait_for_service(
        self,
        name: str,
        timeout: float | None = None,  # noqa: ASYNC109 - rospy's name and meaning
    ) -> None:
        """Return as soon as a provider of the service `name` answers. Raises ServiceUnavailable: none did
        within `timeout` seconds; HintedError: this node may not call it, or the provider may not provide
        it."""
        await self.services.wait_for(self.settings.resolve(name), within=timeout)

    async def wait_ended(self) -> None:
        """Wait until the node ends by itself; raises NodeShutdown: the master ended it."""
        await asyncio.shield(self._ended)

    async def close(self) -> None:
        """Unregister, close every connection, stop every task. Safe to call twice."""
        for publisher in self.topics.publishers.values():
            publisher.close()
        await self._listener.close()
        await self.topics.close_subscribers()
        await self.services.close()
        self.params.close()
        await self.topics.unregister()
        await self._membership.close()
        self._ended.cancel()

    # --- calls of the slave API (SlaveEvents) ---

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        self.topics.publishers_changed(topic, uris)

    def parameter_changed(self, key: str, value: object) -> None:
        self.params.changed(key, value)

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        self._membership.take_push(method, params, master)

    def shutdown_requested(self, reason: str) -> None:
        if not self._ended.done():
            self._ended.set_exception(NodeShutdown(f"the master ended this node: {reason}"))

    def topic_endpoint(self) -> tuple[str, int]:
        return self._host, self._listener.topic_port

    def describe(self) -> dict[str, object]:
        """Values of the informational slave methods, by method name."""
        return {
            "getName": self.name,
            "getUri": self.uri,
            "getMasterUri": self.settings.master_uri,
            "getPid": os.getpid(),
            "getBusStats": [[], [], []],
            "getBusInfo": [],
            **self.topics.describe(),
        }

    @property
    def uri(self) -> str:
        return self._context.uri

    # --- hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        return await self._dialer.rpc(self.settings.master_host, self.settings.master_port)

    async def dial_watch(self) -> SecureStream[Identity]:
        return await self.dial_master()

    async def restore(self) -> None:
        await self.topics.restore()
        await self.services.restore()
        await self.params.restore()

    async def rights_changed(self) -> None:
        # What was refused may be allowed now: everything is registered again.
        await self.restore()

    def maintain(self) -> None:
        self.topics.drop_expired_publishers()

    def crashed(self, error: BaseException) -> None:
        # Fail closed: without its watchdog the node would cut no connection any more.
        if not self._ended.done():
            self._ended.set_exception(error)
        if not self._ended.cancelled():
            self._membership.tasks.spawn(self.close(), f"{self.name}: closing after a failure")


def install() -> None:
    """Show refusals that nobody caught with error and hint, as the command line does.

    Only refusals: any other exception keeps its traceback. So does everything in Python's development mode
    (`python -X dev`), and in a program that has set `sys.excepthook` itself.
    """
    if sys.excepthook is sys.__excepthook__ and not sys.flags.dev_mode:
        sys.excepthook = show


def show(kind: type[BaseException], error: BaseException, traceback: TracebackType | None) -> None:
    """Print what nobody caught, as `sys.excepthook` is called."""
    refusals = _refusals(error)
    if not refusals:
        sys.__excepthook__(kind, error, traceback)
    for refusal in refusals:
        fail(str(refusal), refusal.hint)


def _refusals(error: BaseException) -> list[HintedError]:
    if isinstance(error, HintedError):
        return [error]
    if not isinstance(error, BaseExceptionGroup):
        return []
    parts = [_refusals(part) for part in error.exceptions]
    return [refusal for part in parts for refusal in part] if all(parts) else []
