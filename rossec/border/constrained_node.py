"""The ROS node that stands for one thing: its own identity, grants and ports, and little else.

It is put together from the parts of the built-in node. What differs is that it keeps no connection to
the master (`MasterVisits`), shares what is equal with the other things (`SharedIdentity`: the trust
anchor, the lists of domains and of revocations, limits and tasks), and has no task while nothing
happens. So a resting thing costs little.
"""

import asyncio
import contextlib
import logging
import os
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Final

from ca.certificates import Identity
from ca.errors import CAError, HintedError
from ca.names import shown
from ca.revocation.lists import digest
from ca.revocation.trust_status import TrustStatus
from rossec import clock, errors
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.channel.edhoc.suites import OFFERED_SUITES
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureContext, SecureStream
from rossec.net.limits import HalfOpenCount, HalfOpenLimits
from rossec.net.rpc import RpcClient
from rossec.node import context, node, service, subscriber
from rossec.node.publisher import Publisher
from rossec.node.topics import Topics
from rossec.participant.access import MAX_CALL, NO_LIST, Access, batches
from rossec.participant.authorized import memory_scope
from rossec.participant.connections import ConnectionTable, Dialer, OwnAddresses
from rossec.participant.handshakes import TopicEndpoint
from rossec.participant.master_updates import GrantDelivery, GrantDirectory
from rossec.participant.message_types import message_type
from rossec.participant.registrations import PublisherGrace
from rossec.participant.renewals import IdentityRenewal, Renewals, due_at, renew, renew_identity
from rossec.participant.slave_api import SlaveApi
from rossec.ros import names, xmlrpc
from rossec.ros.names import MASTER, PRESENT_GRANTS, REVOCATION_UPDATE, Settings

HALF_OPEN: Final = HalfOpenLimits(512, 1024)  # of all ports: the master connects to each thing's node
AT_A_TIME: Final = 8  # things that connect to the master at the same time
IDLE: Final = 2.0  # seconds without a call until the connection is closed
_log = logging.getLogger("rossec.border")
_RENEWED_AFTER: Final = 2 / 3  # of the lifetime of an identity
_RETRY: Final = 600  # seconds


@dataclass(frozen=True, eq=False)
class SharedIdentity:
    """What is equal for all identities of this process."""

    trust_status: TrustStatus  # whose peers count, what was revoked; kept current by the border router's node
    settings: Settings
    take_push: Callable[[str, tuple[object, ...], Identity], None]  # from the master, to any identity
    held_list: Callable[[], bytes]  # the signed revocation list
    persist: Callable[[bytes], None]  # stores such a list, durably
    master: str = MASTER
    suites: tuple[int, ...] = OFFERED_SUITES
    turns: asyncio.Semaphore = field(default_factory=lambda: asyncio.Semaphore(AT_A_TIME))
    half_open: HalfOpenCount = field(default_factory=lambda: HalfOpenCount(HALF_OPEN))
    tasks: TaskSet = field(default_factory=TaskSet)  # of all of them; each ends soon


class MasterVisits:
    """Short visits of the thing `name` to its master: a resting thing holds no connection there.

    The border router itself has a session and receives what is signed and new. A thing's own identity
    (`holder`: the thumbprint of its key) connects to register, to fetch and to renew its grants, and
    disconnects when nothing was called for a while. Registrations stay, as those of rospy do.
    """

    def __init__(
        self,
        name: str,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        access: Access,
        holder: bytes,
        directory: GrantDirectory,
        shared: SharedIdentity,
    ) -> None:
        self._name, self._dial, self._access = name, dial, access
        self._holder, self._directory, self._shared = holder, directory, shared
        self._renewals = Renewals(access)
        self._client: RpcClient | None = None
        self._idle: asyncio.TimerHandle | None = None
        self._lock = asyncio.Lock()
        self._used = 0

    @property
    def is_open(self) -> bool:
        return self._client is not None and not self._client.closed

    def renewal_is_due(self, now: int) -> bool:
        return any(
            due_at(held) <= now < held.grant.cap and held.grant.expires < held.grant.cap
            for held in self._access.held_grants()
        )

    async def call(self, method: str, *params: object) -> object:
        client = await self._connected()
        self._used += 1
        try:
            return await client.ask(method, self._name, *params)
        finally:
            self._used -= 1
            self._rest()

    async def update(self) -> int:
        if self.is_open:  # a new connection presents all: what came from the disk since
            await self.present(self._access.current(clock.now())[:MAX_CALL])
        await self._connected()
        trust_status = self._shared.trust_status
        delivery = GrantDelivery(trust_status, self._holder, self._access, self._directory)
        await delivery.fetch(self.call)
        renewed = await renew(self.call, self._renewals, clock.now())
        await self.present(delivery.take_new())
        await delivery.save()
        return delivery.taken + renewed

    async def present(self, grants: list[bytes]) -> None:
        if self.is_open:
            for batch in batches(grants):
                await self.call(PRESENT_GRANTS, batch)

    async def close(self) -> None:
        client, self._client = self._client, None
        if self._idle is not None:
            self._idle.cancel()
            self._idle = None
        if client is not None:
            with contextlib.suppress(HintedError, OSError):
                await client.close()

    async def _connected(self) -> RpcClient:
        async with self._lock:
            if self._client is None or self._client.closed:
                async with self._shared.turns:
                    self._client = await self._open()
            self._rest()
            return self._client

    async def _open(self) -> RpcClient:
        stream = await self._dial()
        if stream.peer.name != self._shared.master:
            stream.abort("not the master")
            raise errors.ConfigurationError(f"{shown(stream.peer.name)} answers at the master's address")
        client = RpcClient(stream)
        try:
            held = digest(self._shared.held_list())
            match await client.ask("rossec.revocationsSince", self._name, held):
                case [bytes() as revocations, bytes() as timestamp]:
                    self._access.update_revocations(
                        revocations, timestamp, stream.peer, clock.now(), self._shared.persist
                    )
                case _:
                    raise CAError(*NO_LIST)
            for batch in batches(self._access.current(clock.now())[:MAX_CALL]):
                await client.ask(PRESENT_GRANTS, self._name, batch)
        except BaseException:
            await client.close()
            raise
        return client

    def _rest(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
        self._idle = asyncio.get_running_loop().call_later(IDLE, self._disconnect)

    def _disconnect(self) -> None:
        if self._used:
            self._rest()
            return
        self._idle = None
        client, self._client = self._client, None
        if client is not None:
            self._shared.tasks.spawn(client.close(), f"{self._name}: leaving the master")


async def quietly(work: Awaitable[object], what: str) -> bool:
    try:
        await work
    except (errors.AnswerRefused, HintedError, OSError, TimeoutError, xmlrpc.Fault) as error:
        _log.warning("%s: %s", what, error)
        return False
    return True


class ThingNode:
    """One node, of a thing; `host`: what it registers."""

    def __init__(self, home: NodeHome, shared: SharedIdentity, host: str) -> None:
        self.name: Final = home.name
        self._home, self._shared, self._host = home, shared, host
        self.closed = self._failed = False
        identity = self._load(clock.now())
        access = Access(shared.trust_status, master=shared.master)
        verify = shared.trust_status.anchors.verify
        secure: SecureContext[Identity] = SecureContext(
            self._credentials, verify, suites=shared.suites, half_open=shared.half_open
        )
        own_addresses = OwnAddresses()
        dialer = Dialer(self.name, secure, access.check_peer, own_addresses)
        self.connections: ConnectionTable[SecureStream[Identity]] = ConnectionTable(
            shared.trust_status, master=shared.master
        )
        self._directory = GrantDirectory(home, access)
        self._grants_at = 0

        def dial_master() -> Awaitable[SecureStream[Identity]]:
            return dialer.rpc(shared.settings.master_host, shared.settings.master_port)

        self._visits = MasterVisits(
            self.name, dial_master, access, identity.thumbprint, self._directory, shared
        )
        self._grace = PublisherGrace(clock.counter())
        scope = memory_scope(self.name)
        self.context = context.NodeContext(
            self.name, access, self.connections, self._visits.call, dialer, home.filter_key, scope
        )
        self._topics = Topics(self.context, self._grace)
        self.services = service.Services(self.context)
        slave, topics = SlaveApi(self, shared.master), self._topics
        self._listener = node.Listener(
            self.context, secure, topics.publishers, self.services, slave, own_addresses
        )

    def _load(self, now: int) -> Identity:
        own = self._shared.trust_status.anchors.own
        if self._home.anchor().thumbprint != own.thumbprint:
            raise errors.ConfigurationError(
                f"{self.name} trusts another authority than this border router",
                f"move {self._home.path} away, then: rossec border add {self.name}",
            )
        identity = self._home.identity(now)
        self._credentials = LiveCredentials(self._home.credentials())
        self._not_after = identity.not_after
        lifetime = identity.not_after - identity.not_before
        self._renew_at = identity.not_before + int(lifetime * _RENEWED_AFTER)
        self._retry_at = 0
        return identity

    def cut(self, reason: str) -> None:
        self.closed = True
        self.connections.close(reason)

    async def start(self) -> None:
        self.take_grants()
        await self._listener.start(self._host)
        self.context.uri = names.build_uri(self._host, self._listener.slave_port)
        self.context.rosrpc = names.build_uri(*self.topic_endpoint(), scheme="rosrpc")

    async def publish(self, topic: str, type_name: str) -> Publisher:
        endpoint = TopicEndpoint(topic, message_type(type_name))
        return await self._topics.publish(endpoint, latch=False, queue_size=10)

    async def subscribe(self, topic: str, type_name: str) -> subscriber.Subscriber:
        endpoint = TopicEndpoint(topic, message_type(type_name))
        return await self._topics.subscribe(endpoint, queue_size=1)

    async def unpublish(self, topic: str) -> None:
        await self._topics.unpublish(self._topics.publishers[topic])

    def take_grants(self) -> list[bytes]:
        try:
            changed = (self._home.path / "grants").stat().st_mtime_ns
        except OSError:
            return []
        if changed == self._grants_at:
            return []
        self._grants_at = changed
        return self._directory.take_new()

    async def update(self) -> None:
        # A master that is out of reach is visited again later (`is_due`).
        self.take_grants()
        what = f"{self.name}: grants"
        self._failed = not await quietly(self._visits.update(), what)
        if self._failed:  # a connection to a master that was restarted is dead without a sign
            await self._visits.close()
            self._failed = not await quietly(self._visits.update(), what)
        if not self._failed:
            if self._is_old(clock.now()):
                await quietly(self._renew(), f"{self.name}: identity")
            await quietly(self.restore(), f"{self.name}: registrations")

    async def restore(self) -> None:
        await self._topics.restore()
        await self.services.restore()

    def is_due(self, now: int) -> bool:
        new = bool(self.take_grants())
        return new or self._failed or self._is_old(now) or self._visits.renewal_is_due(now)

    def maintain(self, now: int) -> None:
        # Called every second, and when something is revoked.
        self.connections.cut_ended(now)
        self._topics.drop_expired_publishers()

    async def close(self, reason: str) -> None:
        self.cut(reason)
        for publisher in self._topics.publishers.values():
            publisher.close()
        await self._listener.close()
        await self._topics.close_subscribers()
        await self.services.close()
        await self._topics.unregister()
        await self._visits.close()

    def _is_old(self, now: int) -> bool:
        return now >= self._renew_at and not now < self._retry_at <= now + _RETRY

    async def _renew(self) -> None:
        now = clock.now()
        self._retry_at = now + _RETRY  # not again before, if it is refused
        renewal = IdentityRenewal(self._home, self._credentials, now)
        if await renew_identity(self._visits.call, renewal, now):
            self._load(now)

    # --- calls of the slave API (SlaveEvents) ---

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        self._topics.publishers_changed(topic, uris)

    def parameter_changed(self, key: str, value: object) -> None: ...

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        # A timestamp alone is of no use: that node has one by its own session.
        if method != REVOCATION_UPDATE or params[0]:
            self._shared.take_push(method, params, master)

    def shutdown_requested(self, reason: str) -> None:
        _log.warning("%s: the master ended this node: %s", self.name, reason)
        self._shared.tasks.spawn(self.close(reason), f"{self.name}: ended by the master")

    def topic_endpoint(self) -> tuple[str, int]:
        return self._host, self._listener.topic_port

    def describe(self) -> dict[str, object]:
        return {
            "getName": self.name,
            "getUri": self.context.uri,
            "getMasterUri": self._shared.settings.master_uri,
            "getPid": os.getpid(),
            "getBusStats": [[], [], []],
            "getBusInfo": [],
            **self._topics.describe(),
        }
