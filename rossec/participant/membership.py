"""The membership of one identity at the master, for every form of a node.

On each connection to the master it fetches and renews the node's grants, presents them, and has
everything registered again. Meanwhile it takes grants that are delivered or arrive in the node's
directory, renews grants and the identity, requests proofs, and takes revocation data. A list is on
disk before it is used.

What a form registers is behind `MembershipHooks`. Fail closed: if a task crashes, connections might
not be cut any more, so the form closes all (`crashed`).
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any, Final, Protocol

from ca.certificates import Identity
from ca.errors import HintedError
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import AnswerRefused, CallRefused
from rossec.home import NodeHome
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.participant.access_interfaces import HandshakeAccess, HeldGrants
from rossec.participant.connections import ConnectionTable
from rossec.participant.domain_updates import DomainUpdates
from rossec.participant.grant_delivery import GrantDelivery, GrantWatch
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.grant_renewal import Renewals, renew
from rossec.participant.identity_renewal import IdentityRenewal, renew_identity
from rossec.participant.master_session import MasterSession
from rossec.participant.presentation import MAX_CALL, batches
from rossec.participant.publisher_grace import PublisherGrace
from rossec.participant.renewed_grants import RenewedGrants
from rossec.participant.revocation_proofs import Provable, prove
from rossec.participant.revocation_watch import ConnectionWatchdog
from rossec.ros import names
from rossec.ros.names import MASTER, PRESENT_GRANTS
from rossec.ros.xmlrpc import Fault
from rossec.saved_domains import DomainFiles
from rossec.saved_revocations import saved_revocations

PERIOD: Final = 1.0  # seconds between checks for new grants and renewals

_log = logging.getLogger("rossec.node")


class LoadedIdentity:
    """An enrolled node as its directory has it when it starts.

    Args:
        home: the directory.
        name: the name the node runs under, which its identity covers.
        master: the certified name of its own master.

    Raises:
        ConfigurationError: no identity, or another node's.
        CertificateRefused, KeyRefused: the identity or the key is invalid.
        RevocationRefused, DomainsRefused: a saved list is not the authority's.
    """

    def __init__(self, home: NodeHome, name: str, master: str = MASTER) -> None:
        self.home = home
        self.name = name
        self.master = master
        self.anchor = home.anchor()
        self.live_credentials = LiveCredentials(home.credentials())
        self.identity = home.identity(clock.now())
        self.revocations = saved_revocations(home, self.anchor, clock.now())
        self.domain_files = DomainFiles(home, self.anchor)
        self.anchors = self.domain_files.anchors()
        self.standing = self.domain_files.standing(self.anchors, self.revocations, clock.now())


class MembershipAccess(HeldGrants, HandshakeAccess, Provable, Protocol):
    """The grants and the revocation data of this node."""

    @property
    def foreign_domains(self) -> frozenset[str]:
        """See `Access.foreign_domains`."""

    def update_revocations(
        self,
        revocations: bytes,
        timestamp: bytes,
        master: Identity,
        now: int,
        persist: Callable[[bytes], None],
    ) -> None:
        """See `Access.update_revocations`."""

    def expire_confirmation(self, until: int) -> None:
        """See `Access.expire_confirmation`."""

    def current(self, now: int) -> list[bytes]:
        """See `Access.current`."""


class MembershipHooks(Protocol):
    """What differs between the forms of a node."""

    async def dial_master(self) -> SecureStream[Identity]:
        """Connect to the master."""

    async def dial_watch(self) -> SecureStream[Identity]:
        """Connect to the master once more, beside the session."""

    async def restore(self) -> None:
        """Make every registration again; the grants are presented."""

    async def rights_changed(self) -> None:
        """Grants are new or renewed: registrations may be made that were refused before."""

    def maintain(self) -> None:
        """Called once in a period."""

    def crashed(self, error: BaseException) -> None:
        """A task has crashed: close everything. Called once."""


class Membership:
    """Keeps one identity connected to the master.

    Args:
        access: of `identity`; with a lock if threads share it.
        connections: cut when they must end.
        grace: the publishers that a restarted master may not list yet.
        lock: held while `identity.standing` is changed, if threads share it.

    Attributes:
        domains: what is known of foreign domains.
        session: the session with the master.
        tasks: the tasks of this identity; a crash of one of them ends everything.
        rights_version: incremented for new grants and lists: what was refused may be tried again.
    """

    def __init__(
        self,
        identity: LoadedIdentity,
        access: MembershipAccess,
        connections: ConnectionTable[Any],
        grace: PublisherGrace,
        hooks: MembershipHooks,
        lock: AbstractContextManager[object] = nullcontext(),  # noqa: B008 - has no state
    ) -> None:
        self._identity = identity
        self._access = access
        self._connections = connections
        self._grace = grace
        self._hooks = hooks
        self._grant_directory = GrantDirectory(identity.home, access)
        self._grant_directory.take_new()
        self._delivery = GrantDelivery(
            identity.standing, identity.identity.thumbprint, access, self._grant_directory
        )
        self.domains = DomainUpdates(
            identity.standing, identity.domain_files, self._domains_changed,
            lambda: access.foreign_domains | connections.domains, lock,
        )  # fmt: skip
        self._renewals = Renewals(access)
        self._renewed = connections.renewed = RenewedGrants(access)
        self._identity_renewal = IdentityRenewal(
            identity.home, identity.live_credentials, clock.now()
        )
        self.session = MasterSession(
            identity.name,
            hooks.dial_master,
            self.update_revocations,
            self._restore,
            lambda: identity.revocations.data,
            lambda call: prove(call, access),
            identity.master,
            self.domains.heartbeat,
            lambda: self._identity_renewal.ended(clock.now()),
        )
        self._watch = GrantWatch(
            identity.name, self._delivery, hooks.dial_watch, lambda: self.session.is_open,
            identity.master,
        )  # fmt: skip
        self.tasks = TaskSet(self._crashed)
        self._has_crashed = False
        self._domains_are_new = False
        self.rights_version = 0

    def start(self, opening: Callable[[], Awaitable[None]] | None = None) -> None:
        """Start the tasks: the session, the watchdog, and maintenance.

        Args:
            opening: opens the session; None: it is open.
        """
        name = self._identity.name
        watchdog = ConnectionWatchdog(self._connections, self._access.expire_confirmation)
        self.tasks.spawn(watchdog.run(), f"{name}: watchdog")
        self.tasks.spawn(self._run_session(opening), f"{name}: master session")
        self.tasks.spawn(self._maintain(), f"{name}: maintenance")
        self.tasks.spawn(self._watch.run(), f"{name}: waiting for grants")

    async def close(self) -> None:
        """Stop every task and end the session; registrations at the master stay."""
        await self.tasks.close()
        await self.session.close()

    def update_revocations(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take a newer list (empty: the one held) and a timestamp, then close what they end.

        Raises:
            CAError: either is refused. What a valid list revokes is closed nevertheless.
        """
        now, before = clock.now(), self._identity.revocations.data
        try:
            self._access.update_revocations(
                revocations, timestamp, master, now, self._identity.home.save_revocations
            )
        finally:  # the list takes effect even when the timestamp is refused
            self._connections.cut_ended(now)
            if self._identity.revocations.data != before:
                self.rights_version += 1

    def take_push(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        """Take what the master pushes, one of `SIGNED_UPDATES`; `params` without the caller_id.

        Raises:
            CAError: it is refused. What it revokes or ends is closed nevertheless.
            CallRefused: not such a call.
        """
        match method, params:
            case names.REVOCATION_UPDATE, (bytes() as revocations, bytes() as timestamp):
                self.update_revocations(revocations, timestamp, master)
            case names.DOMAINS_UPDATE, (bytes() as data,):
                self.domains.take_domains(data)
            case names.FOREIGN_UPDATE, (
                str() as domain, bytes() as revocations, bytes() as timestamp, list() as chain,
            ):  # fmt: skip
                self.domains.take_foreign(domain, revocations, timestamp, chain)
            case _:
                raise CallRefused(f"{method} has other parameters")

    def _domains_changed(self, is_new: bool) -> None:
        """Cut what foreign statements end; what was refused may be tried again."""
        self._connections.cut_ended(clock.now())
        if is_new:
            self.rights_version += 1
            self._domains_are_new = True

    async def _run_session(self, opening: Callable[[], Awaitable[None]] | None) -> None:
        if opening is not None:
            await opening()
        await self.session.run()

    async def _restore(self, session: MasterSession) -> None:
        """Renew, present and register everything again: the master may have been restarted.

        What is held is presented before anything is fetched: calls of the program go on meanwhile.
        """
        self._grace.session_opened()
        with contextlib.suppress(AnswerRefused):  # requested again later
            if await renew(session.call, self._renewals, clock.now()):
                self.rights_version += 1
        await self._present(self._access.current(clock.now())[:MAX_CALL])
        await self._watch.session_opened()
        await self.domains.session_opened(session.call)
        await self._delivery.fetch(session.call)
        await self._present(self._presentable(self._take_new()))
        self._grant_directory.drop_ended(clock.now())
        await self._hooks.restore()
        await self._delivery.save()

    async def _maintain(self) -> None:
        loop = asyncio.get_running_loop()
        due = loop.time() + PERIOD
        while True:
            await self._delivery.wait(due - loop.time())
            is_due = loop.time() >= due
            if is_due:
                due = loop.time() + PERIOD
                self._hooks.maintain()
                self._identity_renewal.take_installed(clock.now())
            new = self._take_new(from_directory=is_due)
            with contextlib.suppress(HintedError, OSError, Fault):  # else later, or on reconnection
                await self._update(new)
            self._renewed.present(self._connections, self.rights_version, clock.now())
            await self._delivery.save()

    def _take_new(self, *, from_directory: bool = True) -> list[bytes]:
        """The grants that were delivered, or have appeared in the directory; they are held."""
        new = self._delivery.take_new()
        if from_directory:
            new += self._grant_directory.take_new()
        if new:
            _log.info("%s: %d new grants", self._identity.name, len(new))
            self.rights_version += 1
        return new

    async def _update(self, new: list[bytes]) -> None:
        """Present `new` grants, renew what is due, request proofs and foreign revocations."""
        call = self.session.call
        await self.domains.fetch_wanted(call)
        new = self._presentable(new)
        await self._present(new)
        renewed = await renew(call, self._renewals, clock.now())
        if renewed:
            self.rights_version += 1
        if new or renewed:
            await self._hooks.rights_changed()
        await renew_identity(call, self._identity_renewal, clock.now())
        if await prove(call, self._access):
            self._connections.cut_ended(clock.now())

    def _presentable(self, new: list[bytes]) -> list[bytes]:
        """`new` grants, or all: those of a domain count only once it is listed."""
        if not self._domains_are_new:
            return new
        self._domains_are_new = False
        return self._access.current(clock.now())[:MAX_CALL]

    async def _present(self, new: list[bytes]) -> None:
        for batch in batches(new):
            await self.session.call(PRESENT_GRANTS, batch)

    def _crashed(self, error: BaseException) -> None:
        if not self._has_crashed:
            self._has_crashed = True
            self._hooks.crashed(error)
