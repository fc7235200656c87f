"""The ROS node that stands for one thing: its own identity, grants and ports, and little else.

It is put together from the parts of the built-in node. What differs is that it keeps no connection
to the master (`master_visits`), shares what is equal with the other things (`shared`), and has no
task while nothing happens.
"""

import logging
import os
from typing import Final

from ca.certificates import Identity
from rossec import clock
from rossec.border.master_visits import MasterVisits, quietly
from rossec.border.shared import SharedIdentity
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, SecureStream
from rossec.node.context import NodeContext
from rossec.node.listener import Listener
from rossec.node.publisher import Publisher
from rossec.node.services import Services
from rossec.node.subscriber import Subscriber
from rossec.node.topics import Topics
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable
from rossec.participant.dialer import Dialer
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.identity_renewal import IdentityRenewal, renew_identity
from rossec.participant.limit_memory import memory_scope
from rossec.participant.message_types import message_type
from rossec.participant.own_addresses import OwnAddresses
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.slave_api import SlaveApi
from rossec.participant.topic_handshake import TopicEndpoint
from rossec.ros import settings
from rossec.ros.names import REVOCATION_UPDATE

_log = logging.getLogger("rossec.border")
_RENEWED_AFTER: Final = 2 / 3  # of the lifetime of an identity
_RETRY: Final = 600  # seconds


class ThingNode:
    """One node, of a thing.

    Args:
        home: its directory, with its key, its identity and its grants.
        shared: what it shares with the other nodes of this process.
        uri_host: the host that it registers.

    Raises:
        ConfigurationError: no identity, another node's, or of another authority.
        CertificateRefused, KeyRefused: the identity or the key is invalid.
    """

    __slots__ = (
        "_connections", "_context", "_credentials", "_directory", "_failed", "_grace", "_grants_at",
        "_home", "_host", "_listener", "_not_after", "_renew_at", "_retry_at", "_shared", "_topics",
        "_visits", "closed", "name", "services",
    )  # fmt: skip

    def __init__(self, home: NodeHome, shared: SharedIdentity, host: str) -> None:
        self.name: Final = home.name
        self._home, self._shared, self._host = home, shared, host
        self.closed = self._failed = False
        identity = self._load(clock.now())
        access = Access(shared.standing, master=shared.master)
        secure: SecureContext[Identity] = SecureContext(
            self._credentials, shared.standing.anchors.verify,
            suites=shared.suites, half_open=shared.half_open,
        )  # fmt: skip
        own_addresses = OwnAddresses()
        dialer = Dialer(self.name, secure, access.check_peer, own_addresses)
        self._connections: ConnectionTable[SecureStream[Identity]] = ConnectionTable(
            shared.standing, master=shared.master
        )
        self._directory = GrantDirectory(home, access)
        self._grants_at = 0
        self._visits = MasterVisits(
            self.name, self._dial_master, access, identity.thumbprint, self._directory, shared
        )
        self._grace = PublisherGrace(clock.counter())
        self._context = NodeContext(
            self.name, access, self._connections, self._visits.call, dialer, home.filter_key,
            memory_scope(self.name),
        )  # fmt: skip
        self._topics = Topics(self._context, self._grace)
        self.services = Services(self._context)
        self._listener = Listener(
            self.name, secure, access, self._topics.publishers, self.services,
            SlaveApi(self, shared.master), self._connections, own_addresses, self.name,
        )  # fmt: skip

    def _load(self, now: int) -> Identity:
        """Verify the identity in the directory, by the anchor that all share."""
        own = self._shared.standing.anchors.own
        if self._home.anchor().thumbprint != own.thumbprint:
            raise ConfigurationError(
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

    @property
    def connections(self) -> ConnectionTable[SecureStream[Identity]]:
        """Its connections with other nodes."""
        return self._connections

    @property
    def context(self) -> NodeContext:
        """What its parts share."""
        return self._context

    def cut(self, reason: str) -> None:
        """Cut every connection at once."""
        self.closed = True
        self._connections.close(reason)

    async def start(self) -> None:
        """Take its grants and listen. Raises `OSError`."""
        self.take_grants()
        await self._listener.start(self._host)
        self._context.uri = settings.build_uri(self._host, self._listener.slave_port)
        self._context.rosrpc = settings.build_uri(*self.topic_endpoint(), scheme="rosrpc")

    async def publish(self, topic: str, type_name: str) -> Publisher:
        """Register a publisher; raises as `Topics.publish`."""
        endpoint = TopicEndpoint(topic, message_type(type_name))
        return await self._topics.publish(endpoint, latch=False, queue_size=10)

    async def subscribe(self, topic: str, type_name: str) -> Subscriber:
        """Register a subscriber; raises as `Topics.subscribe`."""
        endpoint = TopicEndpoint(topic, message_type(type_name))
        return await self._topics.subscribe(endpoint, queue_size=1)

    async def unpublish(self, topic: str) -> None:
        """Unregister a publisher, and cut its subscribers."""
        await self._topics.unpublish(self._topics.publishers[topic])

    def take_grants(self) -> list[bytes]:
        """Hold what is new in its directory; nothing is read while the directory is unchanged."""
        try:
            changed = (self._home.path / "grants").stat().st_mtime_ns
        except OSError:
            return []
        if changed == self._grants_at:
            return []
        self._grants_at = changed
        return self._directory.take_new()

    async def update(self) -> None:
        """Visit the master: fetch and renew grants, the identity too, and register again.

        A master that is out of reach is visited again later (`is_due`).
        """
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
        """Make every registration again: the master was restarted, or grants are new."""
        await self._topics.restore()
        await self.services.restore()

    def is_due(self, now: int) -> bool:
        """Whether something must be renewed, or grants are new: `update` is to be called."""
        new = bool(self.take_grants())
        return new or self._failed or self._is_old(now) or self._visits.renewal_is_due(now)

    def maintain(self, now: int) -> None:
        """Cut connections that must end; called every second, and when something is revoked."""
        self._connections.cut_ended(now)
        self._topics.drop_expired_publishers()

    async def close(self, reason: str) -> None:
        """Unregister, and close every connection."""
        self.cut(reason)
        for publisher in self._topics.publishers.values():
            publisher.close()
        await self._listener.close()
        await self._topics.close_subscribers()
        await self.services.close()
        await self._topics.unregister()
        await self._visits.close()

    def _is_old(self, now: int) -> bool:
        """Whether its identity is to be renewed now, whatever a clock that was ahead has set."""
        return now >= self._renew_at and not now < self._retry_at <= now + _RETRY

    async def _renew(self) -> None:
        now = clock.now()
        self._retry_at = now + _RETRY  # not again before, if it is refused
        renewal = IdentityRenewal(self._home, self._credentials, now)
        if await renew_identity(self._visits.call, renewal, now):
            self._load(now)

    async def _dial_master(self) -> SecureStream[Identity]:
        where = self._shared.settings
        return await self._context.dialer.rpc(where.master_host, where.master_port)

    # --- calls of the slave API (SlaveEvents) ---

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        """Follow the master's list of publishers."""
        self._topics.publishers_changed(topic, uris)

    def parameter_changed(self, key: str, value: object) -> None:
        """Nothing: a thing has no parameters."""

    def revocations_arrived(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Hand a list to the border router's node, whose lists all things share.

        A timestamp alone is of no use: that node has one by its own session.
        """
        if revocations:
            self._shared.take_push(REVOCATION_UPDATE, (revocations, timestamp), master)

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        """Hand it to the border router's node."""
        self._shared.take_push(method, params, master)

    def shutdown_requested(self, reason: str) -> None:
        """Close what this node has: another one took its name, or an administrator ends it."""
        _log.warning("%s: the master ended this node: %s", self.name, reason)
        self._shared.tasks.spawn(self.close(reason), f"{self.name}: ended by the master")

    def topic_endpoint(self) -> tuple[str, int]:
        """Where TCPROS connections are accepted."""
        return self._host, self._listener.topic_port

    def describe(self) -> dict[str, object]:
        """Values of the informational slave methods, by method name."""
        return {
            "getName": self.name,
            "getUri": self._context.uri,
            "getMasterUri": self._shared.settings.master_uri,
            "getPid": os.getpid(),
            "getBusStats": [[], [], []],
            "getBusInfo": [],
            **self._topics.describe(),
        }
