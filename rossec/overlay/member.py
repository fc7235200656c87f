"""The relay as a node of its own domain: its identity, and whom it may have links with. A shell.

As every form of a node it keeps a session with its master, so that lists of domains, revocations
and a renewed certificate arrive. It registers nothing and has no slave API: the master's answer to
a call that waits (`rossec.relayDoors`) is the sign that lists may have changed, and it asks for
them then (`refresh`). Every link is in its table of connections, which cuts it.
"""

import asyncio
import logging
from collections.abc import Mapping
from functools import partial
from typing import Final

from ca.certificates import Identity
from ca.domains.standing import Standing
from ca.errors import HintedError, RevocationsStale
from rossec import clock
from rossec.channel.edhoc.known import KnownCertificates
from rossec.channel.suite_selection import post_quantum
from rossec.environment import own_home, own_master
from rossec.errors import ChannelClosed
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, SecureStream
from rossec.overlay.mux_units import MASTER
from rossec.participant.access import Access
from rossec.participant.connections import ConnectionTable
from rossec.participant.dialer import Dialer
from rossec.participant.membership import LoadedIdentity, Membership
from rossec.participant.publisher_grace import PublisherGrace
from rossec.ros import settings
from rossec.ros.settings import Settings
from rossec.ros.xmlrpc import Fault

_log = logging.getLogger("rossec.overlay")


class RelayMember:
    """The identity of a relay, kept current at its own master.

    Args:
        name: the relay's certified name.
        environ: where ROS_MASTER_URI, ROSSEC_MASTER, ROSSEC_HOME and so on are read from.

    Attributes:
        context: for connections with masters and nodes.
        link_context: for links: certificates are sent by value, as links are made rarely.

    Raises:
        ConfigurationError: no identity, or another node's.
        CertificateRefused, KeyRefused: the identity or the key is invalid.
    """

    def __init__(self, name: str, environ: Mapping[str, str]) -> None:
        self.settings: Final[Settings] = settings.read((), environ, default_name=name)
        home = NodeHome.of(own_home(environ), name)
        loaded = LoadedIdentity(home, name, own_master(environ))
        self.home: Final = home
        self.name: Final = name
        self.master: Final = loaded.master
        self.identity: Final = loaded.identity
        self.standing: Final[Standing] = loaded.standing
        self.access: Final = Access(loaded.standing, master=loaded.master)
        suites = post_quantum(environ)
        verify = loaded.anchors.verify
        self.context: Final = SecureContext(
            loaded.live_credentials, verify, suites=suites, known=KnownCertificates(),
            renews=Identity.renews,
        )  # fmt: skip
        self.link_context: Final = SecureContext(
            loaded.live_credentials, verify, suites=suites, renews=Identity.renews
        )
        self._connections: ConnectionTable[SecureStream[Identity]] = ConnectionTable(
            loaded.standing, master=loaded.master
        )
        self._links: set[SecureStream[Identity]] = set()
        self._failed = False
        self._dialer = Dialer(name, self.context, self.access.check_peer)
        grace = PublisherGrace(clock.counter())
        self._membership = Membership(loaded, self.access, self._connections, grace, self)
        self._ended: asyncio.Future[None] = asyncio.get_running_loop().create_future()

    def start(self) -> None:
        """Begin; a master that is out of reach is tried again."""
        self._membership.start()

    async def wait_ended(self) -> None:
        """Wait until it ends by itself.

        Raises:
            BaseException: what a task crashed with; every link is cut.
        """
        await asyncio.shield(self._ended)

    async def close(self) -> None:
        """End the session and every link."""
        self._abort_links("the relay ends")
        await self._membership.close()
        self._ended.cancel()

    async def refresh(self) -> None:
        """Ask the master now for lists that are new, and cut what they end.

        A master that is out of reach, or refuses, is asked again with the next heartbeat.
        """
        try:
            await self._membership.session.refresh()
        except (HintedError, OSError, TimeoutError, Fault) as error:
            _log.debug("%s: no lists from the master: %s", self.name, error)

    def admit(self, link: SecureStream[Identity]) -> None:
        """Count a link with an authenticated relay until it is closed; it is cut when it must end.

        A foreign relay may come while its domain's revocations are stale, or the masters of two
        domains could never tell each other: `check_target` says for what.

        Raises:
            CAError: the relay is revoked, not trusted any more, or this is not known.
            LimitExceeded: there are too many links with it.
        """
        self._connections.accept(link, link.peer, link.abort)  # a list may arrive meanwhile
        self._links.add(link)
        link.when_closed(partial(self._forget, link))
        if self._failed:
            raise ChannelClosed("the relay has failed")
        try:
            self.check_peer(link.peer)
        except RevocationsStale:
            if not link.peer.is_foreign:
                raise
            for key in link.peer.keys:
                self.standing.own.check(key, clock.now())

    def check_target(self, peer: Identity, kind: str) -> None:
        """Return if a link with `peer` may lead to a target of this kind now.

        Raises:
            CAError: the peer may not come, or nobody has said lately that it may, and the target
                is not a master, which judges by itself.
        """
        try:
            self.check_peer(peer)
        except RevocationsStale:
            if kind != MASTER or not peer.is_foreign:
                raise

    def _forget(self, link: SecureStream[Identity]) -> None:
        self._connections.forget(link)
        self._links.discard(link)

    def check_peer(self, peer: Identity) -> None:
        """Raise a `CAError` when `peer` is revoked, or this is not known."""
        self.access.check_peer(peer, clock.now())

    @property
    def is_connected(self) -> bool:
        """Whether there is a session with the master."""
        return self._membership.session.is_open

    def _abort_links(self, reason: str) -> None:
        for link in tuple(self._links):
            link.abort(reason)

    # -- hooks of the membership (MembershipHooks)

    async def dial_master(self) -> SecureStream[Identity]:
        """Connect to the master."""
        return await self._dialer.rpc(self.settings.master_host, self.settings.master_port)

    async def dial_watch(self) -> SecureStream[Identity]:
        """Connect to the master once more, for a call that waits."""
        return await self.dial_master()

    async def restore(self) -> None:
        """Nothing is registered."""

    async def rights_changed(self) -> None:
        """No registration waits for a right."""

    def maintain(self) -> None:
        """Nothing is due each second: a link ends by itself with the certificate of its peer."""

    def crashed(self, error: BaseException) -> None:
        """Cut every link, and admit none: nothing would cut it."""
        self._failed = True
        self._abort_links("the relay has failed")
        if not self._ended.done():
            self._ended.set_exception(error)
