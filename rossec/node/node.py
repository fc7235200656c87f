"""A ROS node without ROS: topics, services and parameters over the secure channel, in asyncio.

Connects the parts: the master session, the slave API, the TCPROS server, topics and services.
Decisions are made elsewhere: `access` authorizes peers, the handshake modules check headers,
`connections` says when a connection must end, `membership` keeps grants, identity and revocation
data current.
"""

import asyncio
import logging
import os
from collections.abc import Mapping, Sequence
from types import TracebackType
from typing import Self

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.suite_selection import post_quantum
from rossec.environment import own_home, own_master
from rossec.errors import AnswerMalformed, NodeShutdown
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, SecureStream
from rossec.net.host.own_address import warn_of_own_address
from rossec.node import uncaught
from rossec.node.context import NodeContext
from rossec.node.listener import Listener
from rossec.node.params import NodeParameters
from rossec.node.publisher import Publisher
from rossec.node.service import CONCURRENCY, HANDLER_DEADLINE, Handler, Service
from rossec.node.service_client import CALL_DEADLINE, ServiceClient
from rossec.node.services import Services
from rossec.node.subscriber import Subscriber
from rossec.node.topics import Topics
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable
from rossec.participant.dialer import Dialer
from rossec.participant.limit_memory import memory_scope
from rossec.participant.membership import LoadedIdentity, Membership
from rossec.participant.message_types import message_type
from rossec.participant.own_addresses import OwnAddresses
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.service_types import service_type
from rossec.participant.slave_api import SlaveApi
from rossec.participant.topic_handshake import TopicEndpoint
from rossec.participant.wishes import Wishes
from rossec.ros import settings
from rossec.ros.names import ANY_TYPE

_log = logging.getLogger("rossec.node")


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
        self,
        name: str,
        *,
        argv: Sequence[str] = (),
        environ: Mapping[str, str] = os.environ,
    ) -> None:
        uncaught.install()
        self._environ = environ
        self.settings = settings.read(argv, environ, default_name=name)
        self.name = self.settings.name
        loaded = LoadedIdentity(
            NodeHome.find(own_home(environ), self.name), self.name, own_master(environ)
        )
        self.master_name = loaded.master
        self.home, self.anchor, self.identity = loaded.home, loaded.anchor, loaded.identity
        self.credentials, self.revocations = loaded.live_credentials, loaded.revocations
        self.access = Access(loaded.standing, master=loaded.master)
        secure = SecureContext(
            self.credentials, loaded.anchors.verify,
            suites=post_quantum(environ), known=KnownCertificates(), renews=Identity.renews,
        )  # fmt: skip
        own_addresses = OwnAddresses()
        self._dialer = Dialer(
            self.name, secure, self.access.check_peer, own_addresses, self.identity.name
        )
        connections: ConnectionTable[SecureStream[Identity]] = ConnectionTable(
            loaded.standing, master=loaded.master
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
        self._topics = Topics(context, grace)
        self.services = Services(context)
        self.params = NodeParameters(context, self.settings.resolve)
        self._listener = Listener(
            self.name, secure, self.access, self._topics.publishers, self.services,
            SlaveApi(self, loaded.master), connections, own_addresses, self.identity.name,
        )  # fmt: skip
        self._host = ""
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    async def __aenter__(self) -> Self:
        try:
            await self._start()
        except BaseException:
            await self.close()
            raise
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        await self.close()

    async def publisher(
        self, topic: str, type_name: str, *, latch: bool = False, queue_size: int = 10
    ) -> Publisher:
        """Publish messages of `type_name` on `topic`.

        Raises:
            MessageError, RossecError: unknown type, a second publisher of the topic, or the
                master refuses.
        """
        endpoint = TopicEndpoint(self.settings.resolve(topic), message_type(type_name))
        return await self._topics.publish(endpoint, latch=latch, queue_size=queue_size)

    async def topic_types(self) -> dict[str, str]:
        """The topics that have a publisher or subscriber, and that this node may see: their types.

        Raises:
            RossecError: the master refuses, or is out of reach.
        """
        answer = await self._context.call("getTopicTypes")
        found: dict[str, str] = {}
        for row in answer if isinstance(answer, list) else [answer]:
            match row:
                case [str(topic), str(kind)]:
                    found |= {topic: kind} if kind != ANY_TYPE else {}
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

        What each publisher is asked for: at most `rate` messages a second, of those that wait for
        a slow line only the `newest`, messages that are compressed (`deflate`).

        Raises:
            MessageError, RossecError: unknown type, a wrong rate, or the master refuses.
        """
        wishes = Wishes(rate, newest, deflate)
        endpoint = TopicEndpoint(self.settings.resolve(topic), message_type(type_name))
        return await self._topics.subscribe(endpoint, queue_size=queue_size, wishes=wishes)

    @property
    def topics(self) -> Topics:
        """Its topics: for those whose messages are bytes of any type (`publish_raw`)."""
        return self._topics

    async def service(
        self,
        name: str,
        type_name: str,
        handler: Handler,
        *,
        concurrency: int = CONCURRENCY,
        deadline: float = HANDLER_DEADLINE,
    ) -> Service:
        """Provide the service `name`: `handler(request)` returns the response; see `Service`.

        Raises:
            MessageError, RossecError: unknown type, a second provider of the service, or the
                master refuses.
        """
        return await self.services.provide(
            self.settings.resolve(name),
            service_type(type_name),
            lambda request, _: handler(request),
            concurrency=concurrency,
            deadline=deadline,
        )

    def client(
        self,
        name: str,
        type_name: str,
        *,
        persistent: bool = False,
        deadline: float = CALL_DEADLINE,
    ) -> ServiceClient:
        """Call the service `name`: `response = await client(data=True)`; see `ServiceClient`.

        Raises:
            MessageError: unknown type.
        """
        return self.services.client(
            self.settings.resolve(name),
            service_type(type_name),
            persistent=persistent,
            deadline=deadline,
        )

    async def wait_for_service(
        self,
        name: str,
        timeout: float | None = None,  # noqa: ASYNC109 - rospy's name and meaning
    ) -> None:
        """Return as soon as a provider of the service `name` answers.

        Raises:
            ServiceUnavailable: none did within `timeout` seconds.
            HintedError: this node may not call it, or the provider may not provide it.
        """
        await self.services.wait_for(self.settings.resolve(name), within=timeout)

    async def wait_ended(self) -> None:
        """Wait until the node ends by itself.

        Raises:
            NodeShutdown: the master ended it.
        """
        await asyncio.shield(self._ended)

    async def close(self) -> None:
        """Unregister, close every connection, stop every task. Safe to call twice."""
        for publisher in self._topics.publishers.values():
            publisher.close()
        await self._listener.close()
        await self._topics.close_subscribers()
        await self.services.close()
        self.params.close()
        await self._topics.unregister()
        await self._membership.close()
        self._ended.cancel()

    # --- calls of the slave API (SlaveEvents) ---

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        """Follow the master's list of publishers."""
        self._topics.publishers_changed(topic, uris)

    def parameter_changed(self, key: str, value: object) -> None:
        """Notify the subscriptions of the parameter."""
        self.params.changed(key, value)

    def revocations_arrived(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take a newer list and a fresh timestamp, then close connections that must end."""
        self._membership.update_revocations(revocations, timestamp, master)

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        """Take what else the master pushes, then close connections that must end."""
        self._membership.take_push(method, params, master)

    def shutdown_requested(self, reason: str) -> None:
        """End the node: another one took its name, or an administrator shut it down."""
        if not self._ended.done():
            self._ended.set_exception(NodeShutdown(f"the master ended this node: {reason}"))

    def topic_endpoint(self) -> tuple[str, int]:
        """Where TCPROS connections are accepted."""
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
            **self._topics.describe(),
        }

    @property
    def uri(self) -> str:
        """This node's API URI, as registered with the master."""
        return self._context.uri

    # --- hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        """Connect to the master."""
        return await self._dialer.rpc(self.settings.master_host, self.settings.master_port)

    async def dial_watch(self) -> SecureStream[Identity]:
        """Connect to the master once more, for a call that waits."""
        return await self.dial_master()

    async def restore(self) -> None:
        """Make every registration again."""
        await self._topics.restore()
        await self.services.restore()
        await self.params.restore()

    async def rights_changed(self) -> None:
        """Make registrations again: the master may have refused them for lack of a grant."""
        await self.restore()

    def maintain(self) -> None:
        """Drop publishers that a restarted master did not list again in time."""
        self._topics.drop_expired_publishers()

    def crashed(self, error: BaseException) -> None:
        """Close the node when a task fails: without its watchdog it would close no connection."""
        if not self._ended.done():
            self._ended.set_exception(error)
        if not self._ended.cancelled():
            self._membership.tasks.spawn(self.close(), f"{self.name}: closing after a failure")

    async def _start(self) -> None:
        warn_of_own_address(self.settings.address, self._environ, self._warn_of_address)
        stream = await self._membership.session.open()
        self._host = self.settings.address or stream.local_address
        await self._listener.start(self._host)
        self._context.uri = settings.build_uri(self._host, self._listener.slave_port)
        self._context.rosrpc = settings.build_uri(*self.topic_endpoint(), scheme="rosrpc")
        self._membership.start()

    def _warn_of_address(self, error: HintedError) -> None:
        _log.warning("%s: %s (%s)", self.name, error, error.hint)
