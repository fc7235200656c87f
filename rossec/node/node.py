"""A ROS node without ROS: topics over the secure channel, in asyncio.

A shell that wires the parts together: the master session, the slave API, the TCPROS server, the
publishers and subscribers, and the watch over their links. Judgement is elsewhere: `access` says
who may do what, `topics` checks headers, `links` says what must end.
"""

import asyncio
import contextlib
import logging
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from types import TracebackType
from typing import Final, Self

from ca.certificates import Identity
from ca.errors import HintedError
from ca.revocation import Revocations, digest
from grants import layout
from rossec.channel.credentials import LiveCredentials
from rossec.channel.known import KnownCertificates
from rossec.channel.policy import post_quantum
from rossec.errors import AnswerRefused, ConfigurationError, NodeShutdown
from rossec.home import NodeHome, rossec_home
from rossec.net.stream import SecureStream
from rossec.net.tasks import TaskSet
from rossec.node.access import Access
from rossec.node.dial import Dialer
from rossec.node.identity import IdentityRenewal, renew_identity
from rossec.node.links import Link
from rossec.node.listener import Listener
from rossec.node.messages import message_type
from rossec.node.proofs import prove
from rossec.node.publisher import Publisher
from rossec.node.renewal import Renewals, renew
from rossec.node.session import MasterSession
from rossec.node.shelf import Shelf
from rossec.node.slave import SlaveApi
from rossec.node.subscriber import Subscriber
from rossec.node.topics import Endpoint
from rossec.node.watch import Watch
from rossec.ros import settings

_PRESENTED: Final = 64  # as many as the master keeps of one node
_COLLECT: Final = 1.0  # seconds between looks for new grants

_log = logging.getLogger("rossec.node")


class Node:
    """One node: `async with Node("/camera") as node: ...`.

    Args:
        name: the node's name; `__name:=` and `__ns:=` in `argv` change it as in ROS. For
            `/rviz_17` an identity of `/rviz` for anonymous nodes will do.
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
        self.home = NodeHome.find(rossec_home(environ), self.name)
        self.anchor = self.home.anchor()
        self.credentials = LiveCredentials(self.home.credentials())
        self.identity = self.home.identity(int(time.time()))
        self.revocations = self._load_revocations()
        self.access = Access(self.anchor, self.revocations)
        suites, known = post_quantum(environ), KnownCertificates()
        self._dialer = Dialer(
            self.name,
            self.credentials,
            self.anchor,
            self.access.check_peer,
            suites=suites,
            known=known,
        )
        self._shelf = Shelf(self.home, self.access)
        self._shelf.take_new()
        self._publishers: dict[str, Publisher] = {}
        self._subscribers: dict[str, list[Subscriber]] = {}
        self._tasks = TaskSet(on_crash=self._crashed)
        self._session = MasterSession(
            self.name,
            self._dial_master,
            self.revocations_arrived,
            self._restore,
            lambda: digest(self.revocations.data),
            lambda call: prove(call, self.revocations),
        )
        self._renewals = Renewals(self.access)
        self._identity_renewal = IdentityRenewal(self.home, self.credentials, int(time.time()))
        self._listener = Listener(
            self.name,
            self.credentials,
            self.anchor,
            self.access,
            self._publishers,
            SlaveApi(self),
            suites=suites,
            known=known,
        )
        self._watch = Watch(self.revocations, self._links, self._listener)
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
        endpoint = Endpoint(self.settings.resolve(topic), message_type(type_name))
        if endpoint.topic in self._publishers:
            raise ConfigurationError(f"{endpoint.topic} is published by this node already")
        shape = layout.parse(type_name, endpoint.type.definition)
        publisher = Publisher(
            endpoint, shape, self.home.filter_key, latch=latch, queue_size=queue_size
        )
        self._publishers[endpoint.topic] = publisher
        try:
            await self._register_publisher(self._session, publisher)
        except BaseException:
            del self._publishers[endpoint.topic]
            raise
        return publisher

    async def subscriber(self, topic: str, type_name: str, *, queue_size: int = 10) -> Subscriber:
        """Receive messages of `type_name` on `topic`: `async for message in subscriber`.

        Raises:
            MessageError, RossecError: unknown type, or the master refuses.
        """
        endpoint = Endpoint(self.settings.resolve(topic), message_type(type_name))
        subscriber = Subscriber(
            self.name,
            endpoint,
            self.access,
            self._dialer.topic,
            self._forget,
            queue_size=queue_size,
        )
        self._subscribers.setdefault(endpoint.topic, []).append(subscriber)
        try:
            await self._register_subscriber(self._session, subscriber)
        except BaseException:
            await subscriber.close()
            raise
        return subscriber

    async def _forget(self, subscriber: Subscriber) -> None:
        """A subscriber was closed; the last one of its topic unregisters."""
        others = self._subscribers.get(subscriber.topic, [])
        if subscriber in others:
            others.remove(subscriber)
        if not others and self._subscribers.pop(subscriber.topic, None) is not None:
            with contextlib.suppress(HintedError, OSError):
                await self._session.call("unregisterSubscriber", subscriber.topic, self.uri)

    async def wait_ended(self) -> None:
        """Wait until the node ends by itself.

        Raises:
            NodeShutdown: the master ended it.
        """
        await asyncio.shield(self._ended)

    async def close(self) -> None:
        """Unregister, cut every connection, stop every task. Safe to call twice."""
        for publisher in self._publishers.values():
            publisher.close()
        await self._listener.close()
        for subscriber in self._all_subscribers():
            await subscriber.close()
        await self._unregister()
        await self._tasks.close()
        await self._session.close()
        self._ended.cancel()

    # --- what the slave API reports (SlaveEvents) ---

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        """Follow the master's list of publishers."""
        for subscriber in self._subscribers.get(topic, []):
            subscriber.update([uri for uri in uris if uri != self.uri])

    def revocations_arrived(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take over a newer list and a fresh timestamp, then cut what they end."""
        now = int(time.time())
        try:
            self.access.take_news(revocations, timestamp, master, now, self.home.save_revocations)
        finally:  # what the list revokes ends, whatever is wrong with the timestamp
            self._watch.cut(now)

    def shutdown_requested(self, reason: str) -> None:
        """End the node: another one took its name, or an administrator wants it so."""
        if not self._ended.done():
            self._ended.set_exception(NodeShutdown(f"the master ended this node: {reason}"))

    def topic_endpoint(self) -> tuple[str, int]:
        """Where TCPROS connections are accepted."""
        return self._host, self._listener.topic_port

    def describe(self) -> dict[str, object]:
        """What the informational slave methods tell the master."""
        publications = [[item.topic, item.endpoint.type.name] for item in self._publishers.values()]
        subscriptions = [[item.topic, item.endpoint.type.name] for item in self._all_subscribers()]
        return {
            "getMasterUri": self.settings.master_uri,
            "getPid": os.getpid(),
            "getBusStats": [[], [], []],
            "getBusInfo": [],
            "getSubscriptions": subscriptions,
            "getPublications": publications,
        }

    @property
    def uri(self) -> str:
        """This node's API URI, as registered with the master."""
        return _uri(self._host, self._listener.slave_port)

    # --- start ---

    async def _start(self) -> None:
        stream = await self._session.open()
        self._host = self.settings.address or stream.local_address
        await self._listener.start(self._host)
        self._tasks.spawn(self._session.keep(), f"{self.name}: master session")
        self._tasks.spawn(self._watch.run(), f"{self.name}: watch")
        self._tasks.spawn(self._collect_grants(), f"{self.name}: grants")

    def _load_revocations(self) -> Revocations:
        """The newest list seen before the last stop: an older one will not be believed."""
        revocations = Revocations(self.anchor.public_key)
        saved = self.home.load_revocations()
        if saved is not None:
            revocations.update(saved, int(time.time()))
        return revocations

    async def _dial_master(self) -> SecureStream[Identity]:
        return await self._dialer.rpc(self.settings.master_host, self.settings.master_port)

    async def _restore(self, session: MasterSession) -> None:
        with contextlib.suppress(AnswerRefused):  # what is not renewed now is asked for later
            await renew(session.call, self._renewals, int(time.time()))
        current = self.access.current(int(time.time()))
        await session.call("rossec.presentGrants", current[:_PRESENTED])
        for publisher in self._publishers.values():
            await self._register_publisher(session, publisher)
        for subscriber in self._all_subscribers():
            await self._register_subscriber(session, subscriber)

    async def _register_publisher(self, session: MasterSession, publisher: Publisher) -> None:
        endpoint = publisher.endpoint
        await session.call("registerPublisher", endpoint.topic, endpoint.type.name, self.uri)

    async def _register_subscriber(self, session: MasterSession, subscriber: Subscriber) -> None:
        endpoint = subscriber.endpoint
        before = subscriber.updates
        uris = await session.call(
            "registerSubscriber", endpoint.topic, endpoint.type.name, self.uri
        )
        if isinstance(uris, list) and subscriber.updates == before:  # a push may have been faster
            subscriber.update([uri for uri in uris if isinstance(uri, str) and uri != self.uri])

    async def _unregister(self) -> None:
        try:
            for topic in self._publishers:
                await self._session.call("unregisterPublisher", topic, self.uri)
        except (HintedError, OSError, TimeoutError) as error:
            _log.info("%s: left without unregistering: %s", self.name, error)

    # --- what must end ---

    def _links(self) -> Iterator[Link]:
        for publisher in self._publishers.values():
            yield from publisher.links
        for subscriber in self._all_subscribers():
            yield from subscriber.links

    def _all_subscribers(self) -> list[Subscriber]:
        return [item for items in self._subscribers.values() for item in items]

    async def _collect_grants(self) -> None:
        """A grant that arrives in the node's directory, or is renewed, counts without a restart."""
        while True:
            await asyncio.sleep(_COLLECT)
            new = self._shelf.take_new()
            with contextlib.suppress(HintedError, OSError):  # else with the next connection
                if new:
                    _log.info("%s: %d new grants", self.name, len(new))
                    await self._session.call("rossec.presentGrants", new)
                await renew(self._session.call, self._renewals, int(time.time()))
                await renew_identity(self._session.call, self._identity_renewal, int(time.time()))
                if await prove(self._session.call, self.revocations):
                    self._watch.cut(int(time.time()))

    def _crashed(self, error: BaseException) -> None:
        """A node whose watch has died must not go on: it would no longer cut anything."""
        if not self._ended.done():
            self._ended.set_exception(error)
            self._tasks.spawn(self.close(), f"{self.name}: closing after a failure")


def _uri(host: str, port: int) -> str:
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"
