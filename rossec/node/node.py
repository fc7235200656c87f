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
from ca.revocation import Revocations, open_timestamp
from grants import layout
from rossec.errors import ConfigurationError, NodeShutdown, TopicRefused
from rossec.home import NodeHome, rossec_home
from rossec.net.rpc import RpcClient
from rossec.net.stream import Flavour, SecureStream, connect
from rossec.net.tasks import TaskSet
from rossec.node.access import Access
from rossec.node.links import Link, why_cut
from rossec.node.listener import Listener
from rossec.node.messages import message_type
from rossec.node.publisher import Publisher
from rossec.node.session import MasterSession
from rossec.node.shelf import Shelf
from rossec.node.slave import SlaveApi
from rossec.node.subscriber import Subscriber
from rossec.node.topics import Endpoint
from rossec.ros import settings

_WATCH: Final = 1.0  # seconds between looks at what has expired or gone stale

_log = logging.getLogger("rossec.node")


class Node:
    """One node: `async with Node("/camera") as node: ...`.

    Args:
        name: the node's name; `__name:=` and `__ns:=` in `argv` change it as in ROS.
        argv: ROS arguments of the program (remappings and the like), without its path.
        environ: where ROS_MASTER_URI, ROS_IP and so on, and ROSSEC_HOME are read from.
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
        self.home = NodeHome.of(rossec_home(environ), self.name)
        self.anchor = self.home.anchor()
        self.credentials = self.home.credentials()
        self.revocations = self._load_revocations()
        self.access = Access(self.anchor, self.revocations)
        self._shelf = Shelf(self.home, self.access)
        self._shelf.take_new()
        self._publishers: dict[str, Publisher] = {}
        self._subscribers: dict[str, list[Subscriber]] = {}
        self._tasks = TaskSet(on_crash=self._crashed)
        self._session = MasterSession(
            self.name, self._dial_master, self.revocations_arrived, self._restore
        )
        self._listener = Listener(
            self.name, self.credentials, self.anchor, self.access, self._publishers, SlaveApi(self)
        )
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
        await self._register_publisher(self._session, publisher)
        self._publishers[endpoint.topic] = publisher
        return publisher

    async def subscriber(self, topic: str, type_name: str, *, queue_size: int = 10) -> Subscriber:
        """Receive messages of `type_name` on `topic`: `async for message in subscriber`.

        Raises:
            MessageError, RossecError: unknown type, or the master refuses.
        """
        endpoint = Endpoint(self.settings.resolve(topic), message_type(type_name))
        subscriber = Subscriber(
            self.name, endpoint, self.access, self._dial_topic, queue_size=queue_size
        )
        await self._register_subscriber(self._session, subscriber)
        self._subscribers.setdefault(endpoint.topic, []).append(subscriber)
        return subscriber

    async def wait_ended(self) -> None:
        """Wait until the node ends by itself.

        Raises:
            NodeShutdown: the master ended it.
        """
        await asyncio.shield(self._ended)

    async def close(self) -> None:
        """Unregister, cut every connection, stop every task. Safe to call twice."""
        await self._unregister()
        await self._tasks.close()
        for subscriber in self._all_subscribers():
            await subscriber.close()
        await self._listener.close()
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
        self.revocations.update(revocations, now, self.home.save_revocations)
        try:
            self.revocations.confirm(open_timestamp(timestamp, master.public_key), now)
            self.revocations.check(master.thumbprint, now)
        finally:  # what the list revokes ends, whatever is wrong with the timestamp
            self._cut(now)

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
        self._tasks.spawn(self._watch(), f"{self.name}: watch")

    def _load_revocations(self) -> Revocations:
        """The newest list seen before the last stop: an older one will not be believed."""
        revocations = Revocations(self.anchor.public_key)
        saved = self.home.load_revocations()
        if saved is not None:
            revocations.update(saved, int(time.time()))
        return revocations

    async def _dial_master(self) -> SecureStream[Identity]:
        where = self.settings.master_host, self.settings.master_port
        return await connect(*where, self.credentials, self.anchor.verify, opening=Flavour.HTTP)

    async def _dial_topic(self, uri: str, topic: str) -> SecureStream[Identity]:
        """Ask the node at `uri` where its topics are, then connect there."""
        host, port = settings.parse_uri(uri, "a publisher's URI")
        stream = await connect(
            host, port, self.credentials, self.anchor.verify, opening=Flavour.HTTP
        )
        try:
            answer = await RpcClient(stream).ask("requestTopic", self.name, topic, [["TCPROS"]])
        finally:
            await stream.close()
        match answer:
            case ["TCPROS", str() as host, int() as port]:
                return await connect(host, port, self.credentials, self.anchor.verify)
            case _:
                raise TopicRefused(f"{stream.peer.name} offers no connection for {topic}")

    async def _restore(self, session: MasterSession) -> None:
        await session.call("rossec.presentGrants", self.access.held)
        for publisher in self._publishers.values():
            await self._register_publisher(session, publisher)
        for subscriber in self._all_subscribers():
            await self._register_subscriber(session, subscriber)

    async def _register_publisher(self, session: MasterSession, publisher: Publisher) -> None:
        endpoint = publisher.endpoint
        await session.call("registerPublisher", endpoint.topic, endpoint.type.name, self.uri)

    async def _register_subscriber(self, session: MasterSession, subscriber: Subscriber) -> None:
        endpoint = subscriber.endpoint
        uris = await session.call(
            "registerSubscriber", endpoint.topic, endpoint.type.name, self.uri
        )
        if isinstance(uris, list):
            subscriber.update([uri for uri in uris if isinstance(uri, str) and uri != self.uri])

    async def _unregister(self) -> None:
        try:
            for topic in self._publishers:
                await self._session.call("unregisterPublisher", topic, self.uri)
            for topic in self._subscribers:
                await self._session.call("unregisterSubscriber", topic, self.uri)
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

    async def _watch(self) -> None:
        """Cut links when they expire, and all of them when revocations stay unknown."""
        while True:
            now = time.time()
            soonest = min((link.ends for link in self._links()), default=now + _WATCH)
            await asyncio.sleep(max(0.0, min(_WATCH, soonest - now)))
            self._cut(int(time.time()))
            await self._take_new_grants()

    async def _take_new_grants(self) -> None:
        """A grant that arrives in the node's directory counts without a restart."""
        new = self._shelf.take_new()
        if new:
            _log.info("%s: %d new grants", self.name, len(new))
            with contextlib.suppress(HintedError):  # else presented with the next connection
                await self._session.call("rossec.presentGrants", new)

    def _cut(self, now: int) -> None:
        for link in self._links():
            reason = why_cut(link, self.revocations, now)
            if reason is not None:
                _log.warning("cut %s: %s", link.stream.peer.name, reason)
                link.stream.abort(reason)

    def _crashed(self, error: BaseException) -> None:
        """A node whose watch has died must not go on: it would no longer cut anything."""
        if not self._ended.done():
            self._ended.set_exception(error)
        for link in self._links():
            link.stream.abort("this node failed")


def _uri(host: str, port: int) -> str:
    return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"
