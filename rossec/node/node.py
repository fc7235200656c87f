"""A ROS node without ROS: topics, services and parameters over the secure channel, in asyncio.

Connects the parts: the master session, the slave API, the TCPROS server, topics and services, and
the watchdog of their connections. Decisions are made elsewhere: `access` authorizes peers, the
handshake modules check headers, `connections` says when a connection must end.
"""

import asyncio
import contextlib
import logging
import os
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Final, Self

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.suite_selection import post_quantum
from rossec.environment import own_home
from rossec.errors import AnswerRefused, NodeShutdown
from rossec.home import NodeHome
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
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
from rossec.participant.connections import AuthorizedConnection
from rossec.participant.dialer import Dialer
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.grant_renewal import Renewals, renew
from rossec.participant.identity_renewal import IdentityRenewal, renew_identity
from rossec.participant.limit_memory import memory_scope
from rossec.participant.master_session import MasterSession
from rossec.participant.message_types import message_type
from rossec.participant.own_addresses import OwnAddresses
from rossec.participant.revocation_proofs import prove
from rossec.participant.revocation_watch import ConnectionWatchdog
from rossec.participant.service_types import service_type
from rossec.participant.slave_api import SlaveApi
from rossec.participant.topic_handshake import TopicEndpoint
from rossec.ros import settings
from rossec.saved_revocations import saved_revocations

_PRESENTED: Final = 64  # the master stores this many of one node
_MAINTENANCE_PERIOD: Final = 1.0  # seconds between checks for new grants and renewals

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
        self.settings = settings.read(argv, environ, default_name=name)
        self.name = self.settings.name
        self.home = NodeHome.find(own_home(environ), self.name)
        self.anchor = self.home.anchor()
        self.credentials = LiveCredentials(self.home.credentials())
        self.identity = self.home.identity(clock.now())
        self.revocations = saved_revocations(self.home, self.anchor, clock.now())
        self.access = Access(self.anchor, self.revocations)
        suites, known, own_addresses = post_quantum(environ), KnownCertificates(), OwnAddresses()
        self._dialer = Dialer(
            self.name, self.credentials, self.anchor, self.access.check_peer,
            suites=suites, known=known, own_addresses=own_addresses,
        )  # fmt: skip
        self._grant_directory = GrantDirectory(self.home, self.access)
        self._grant_directory.take_new()
        self._tasks = TaskSet(on_crash=self._crashed)
        self._session = MasterSession(
            self.name,
            self._dial_master,
            self.revocations_arrived,
            self._restore,
            lambda: self.revocations.data,
            lambda call: prove(call, self.revocations),
        )
        self._renewals = Renewals(self.access)
        context = NodeContext(
            self.name,
            self.access,
            self.revocations,
            self._session.call,
            self._dialer,
            self.home.filter_key,
            memory_scope(self.name),
            uri=lambda: self.uri,
            rosrpc=lambda: settings.build_uri(*self.topic_endpoint(), scheme="rosrpc"),
        )
        self._topics = Topics(context)
        self.services = Services(context)
        self.params = NodeParameters(context, self.settings.resolve)
        self._identity_renewal = IdentityRenewal(self.home, self.credentials, clock.now())
        self._listener = Listener(
            self.name, self.credentials, self.anchor, self.access,
            self._topics.publishers, self.services, SlaveApi(self),
            suites=suites, known=known, own_addresses=own_addresses,
        )  # fmt: skip
        self._watchdog = ConnectionWatchdog(self.revocations, self._connections, self._listener)
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

    async def subscriber(self, topic: str, type_name: str, *, queue_size: int = 10) -> Subscriber:
        """Receive messages of `type_name` on `topic`: `async for message in subscriber`.

        Raises:
            MessageError, RossecError: unknown type, or the master refuses.
        """
        endpoint = TopicEndpoint(self.settings.resolve(topic), message_type(type_name))
        return await self._topics.subscribe(endpoint, queue_size=queue_size)

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
            handler,
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
        await self._tasks.close()
        await self._session.close()
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
        now = clock.now()
        try:
            self.access.update_revocations(
                revocations, timestamp, master, now, self.home.save_revocations
            )
        finally:  # the list takes effect even when the timestamp is refused
            self._watchdog.close_terminated(now)

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
        return settings.build_uri(self._host, self._listener.slave_port)

    async def _start(self) -> None:
        stream = await self._session.open()
        self._host = self.settings.address or stream.local_address
        await self._listener.start(self._host)
        self._tasks.spawn(self._session.run(), f"{self.name}: master session")
        self._tasks.spawn(self._watchdog.run(), f"{self.name}: watchdog")
        self._tasks.spawn(self._maintain(), f"{self.name}: maintenance")

    async def _dial_master(self) -> SecureStream[Identity]:
        return await self._dialer.rpc(self.settings.master_host, self.settings.master_port)

    async def _restore(self, session: MasterSession) -> None:
        self._topics.session_opened()
        with contextlib.suppress(AnswerRefused):  # requested again later
            await renew(session.call, self._renewals, clock.now())
        current = self.access.current(clock.now())
        await session.call("rossec.presentGrants", current[:_PRESENTED])
        await self._register()

    async def _register(self) -> None:
        await self._topics.restore()
        await self.services.restore()
        await self.params.restore()

    def _connections(self) -> Iterator[AuthorizedConnection]:
        yield from self._topics.connections()
        yield from self.services.connections()

    async def _maintain(self) -> None:
        """Load new grants, renew grants and the identity, request proofs: periodically."""
        while True:
            await asyncio.sleep(_MAINTENANCE_PERIOD)
            self._topics.drop_expired_publishers()
            new = self._grant_directory.take_new()
            with contextlib.suppress(HintedError, OSError):  # retried later
                if new:
                    _log.info("%s: %d new grants", self.name, len(new))
                    await self._session.call("rossec.presentGrants", new)
                renewed = await renew(self._session.call, self._renewals, clock.now())
                if new or renewed:
                    await self._register()  # registrations refused before for lack of the grant
                await renew_identity(self._session.call, self._identity_renewal, clock.now())
                if await prove(self._session.call, self.revocations):
                    self._watchdog.close_terminated(clock.now())

    def _crashed(self, error: BaseException) -> None:
        """Close the node when a task fails: without its watchdog it would close no connection."""
        if not self._ended.done():
            self._ended.set_exception(error)
            self._tasks.spawn(self.close(), f"{self.name}: closing after a failure")
