"""The membership of one identity at the master, for every form of a node, and its session there.

On each connection the node checks that the peer is its master in its own trust domain, loads revocations,
fetches, renews and presents its grants and registers everything again, so that a master can restart without
the node's program noticing. Meanwhile it takes what is delivered, renews, requests proofs and takes
revocation data: the heartbeat fetches it as well, since pushed updates alone could be suppressed unnoticed
(RFC 9770 section 11 requires the same). Fail closed: if a task crashes, connections might not be cut any
more, so the form closes all (`crashed`).
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from secrets import SystemRandom
from typing import Any, Final, Protocol

from ca.certificates import Identity
from ca.errors import CAError, ClocksDisagree, HintedError, RevocationRefused, RevocationsStale
from ca.names import shown
from ca.revocation.lists import digest, is_tree, open_timestamp
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.environment import OWN_MASTER
from rossec.errors import AnswerRefused, ChannelError, ConfigurationError, RossecError
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.net.aio import SecureStream, as_master
from rossec.net.rpc import RpcClient
from rossec.participant import renewals
from rossec.participant.access import MAX_CALL, NO_LIST, MembershipAccess, batches
from rossec.participant.authorized import RenewedGrants
from rossec.participant.connections import ConnectionTable, ConnectionWatchdog
from rossec.participant.master_updates import DomainUpdates, GrantDelivery, GrantDirectory, GrantWatch
from rossec.participant.registrations import PublisherGrace, Retry
from rossec.participant.renewals import prove
from rossec.ros import names
from rossec.ros.xmlrpc import Fault
from rossec.saved_statements import DomainFiles, saved_revocations

# A timestamp holds for 30 s: two heartbeats may fail (attack `withheld-revocations`).
HEARTBEAT: Final = 10.0
PERIOD: Final = 1.0  # seconds between checks for new grants and renewals
_SAID_AGAIN: Final = 60.0  # seconds after which a cause that lasts is logged again

_log = logging.getLogger("rossec.node")


@dataclass(eq=False)
class MasterSession:
    """Calls to the master, over a connection that is kept open."""

    _name: str  # the node's own, the `caller_id` of every call
    _dial: Callable[[], Awaitable[SecureStream[Identity]]]
    _refresh: Callable[[bytes, bytes, Identity], None]  # takes the newest list and timestamp, or raises
    _restore: Callable[["MasterSession"], Awaitable[None]]  # called on each new connection
    _held: Callable[[], bytes]  # the signed revocation list, which the master then need not send
    _prove: Callable[[renewals.MasterCall], Awaitable[int]]  # requests proofs; how many were accepted
    _master: str = names.MASTER  # the certified name of the node's own
    _follow: Callable[[renewals.MasterCall], Awaitable[None]] | None = None  # after each heartbeat
    _explain: Callable[[], str] = str  # the cause of a failure, if the node knows it itself
    _client: RpcClient | None = field(default=None, init=False)
    _stream: SecureStream[Identity] | None = field(default=None, init=False)
    _is_restored: bool = field(default=False, init=False)

    @property
    def is_open(self) -> bool:
        return self._is_restored and self._client is not None and not self._client.closed

    async def call(self, method: str, *params: object) -> object:
        return await self._connected().ask(method, self._name, *params)

    async def forward(self, method: str, *params: object) -> object:
        return await self._connected().call(method, *params)

    def _connected(self) -> RpcClient:
        if self._client is None or self._client.closed:
            raise RossecError("the master is out of reach", "is `rossec master` running there?")
        return self._client

    async def open(self) -> SecureStream[Identity]:
        try:
            stream = await self._dial()
        except ChannelError as error:
            raise as_master(error) from error
        # Any node of the domain may listen at that address: before anything is said, is it the master?
        if stream.peer.name != self._master:
            stream.abort("not the master")
            raise ConfigurationError(
                f"the node at the master's address is {shown(stream.peer.name)}, not {self._master}",
                f"check ROS_MASTER_URI, and {OWN_MASTER} if there are several masters",
            )
        await self.close()
        self._client, self._stream = RpcClient(stream), stream
        try:
            await self._heartbeat()
            await self._restore(self)
        except BaseException:  # no caller may use a session that failed to open
            await self.close()
            raise
        self._is_restored = True
        return stream

    async def run(self) -> None:
        # Send heartbeats, and reconnect whenever the connection is lost. Runs until cancelled.
        retry = Retry(SystemRandom().random)
        said, said_at = "", 0.0
        while True:
            try:
                if self._client is None or self._client.closed:
                    await self.open()
                    _log.info("%s: connected to the master again", self._name)
                # A lost connection is noticed at once, and not at the next heartbeat.
                if self._stream is not None:
                    with contextlib.suppress(TimeoutError):
                        async with asyncio.timeout(HEARTBEAT):
                            await self._stream.wait_ended()
                await self.refresh()
                retry.succeeded()
                said = ""
            except (HintedError, OSError, Fault) as error:
                text, now = self._explain() or str(error), asyncio.get_running_loop().time()
                if text != said or now - said_at >= _SAID_AGAIN:
                    _log.warning("%s: no answer from the master: %s", self._name, text)
                    said, said_at = text, now
                await self.close()
                await asyncio.sleep(retry.pause(now))

    async def refresh(self) -> None:
        await self._heartbeat()
        if self._follow is not None:
            await self._follow(self.call)

    async def close(self) -> None:
        client, self._client = self._client, None
        self._is_restored = False
        if client is not None:
            await client.close()

    async def _heartbeat(self) -> None:
        try:
            await self._fetch_revocations()
        except RevocationRefused:
            if not await self._send_held_list():
                raise
            await self._fetch_revocations()

    async def _send_held_list(self) -> bool:
        # A master whose list was rolled back: new nodes would accept the old one. Of a tree a node does not
        # have the entries, which the master needs.
        newest = self._held()
        if not newest or is_tree(newest):
            return False
        try:
            newer = await self.call("rossec.updateRevocations", newest) == 1
        except (AnswerRefused, Fault) as error:
            _log.warning("%s: the master refuses this node's revocation list: %s", self._name, error)
            return False
        if newer:
            _log.warning(
                "%s: the master had an older revocation list than this node, and has received"
                " the newer one: was its home restored from a backup?",
                self._name,
            )
        return newer

    async def _fetch_revocations(self) -> None:
        answer = await self.call("rossec.revocationsSince", digest(self._held()))
        match answer, self._stream:
            case [bytes() as revocations, bytes() as timestamp], SecureStream(peer=master):
                try:
                    self._apply(revocations, timestamp, master)
                except RevocationsStale:  # of a tree: the master's own key has no proof yet
                    if not await self._prove(self.call):
                        raise
                    self._apply(revocations, timestamp, master)
            case _:
                raise CAError(*NO_LIST)

    def _apply(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        # Only the answer to the node's own call may correct the clock: it is at most as old as the call.
        try:
            self._refresh(revocations, timestamp, master)
        except ClocksDisagree:  # only then before it is taken: a revoked master sets no clock
            if not clock.correct(open_timestamp(timestamp, master.public_key).issued):
                raise
            self._refresh(revocations, timestamp, master)
        else:
            clock.correct(open_timestamp(timestamp, master.public_key).issued)


class LoadedIdentity:
    """An enrolled node as its directory has it when it starts; its identity covers `name`."""

    def __init__(self, home: NodeHome, name: str, master: str = names.MASTER) -> None:
        self.home = home
        self.name = name
        self.master = master
        self.anchor = home.anchor()
        self.live_credentials = LiveCredentials(home.credentials())
        self.identity = home.identity(clock.now())
        self.revocations = saved_revocations(home, self.anchor, clock.now())
        self.domain_files = DomainFiles(home, self.anchor)
        self.anchors = self.domain_files.anchors()
        self.trust_status = self.domain_files.trust_status(self.anchors, self.revocations, clock.now())


class MembershipHooks(Protocol):
    async def dial_master(self) -> SecureStream[Identity]: ...
    async def dial_watch(self) -> SecureStream[Identity]: ...
    async def restore(self) -> None: ...
    async def rights_changed(self) -> None: ...
    def maintain(self) -> None: ...
    def crashed(self, error: BaseException) -> None: ...


class Membership:
    """Keeps one identity connected to the master. `lock` is held while `identity.trust_status` is changed, if
    threads share it; then `access` has a lock, too."""

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
        self._cut_for: bytes | None = None  # the list for which all that it ends was cut
        self._grace = grace
        self._hooks = hooks
        self._grant_directory = GrantDirectory(identity.home, access)
        self._grant_directory.take_new()
        self._delivery = GrantDelivery(
            identity.trust_status, identity.identity.thumbprint, access, self._grant_directory
        )
        self.domains = DomainUpdates(
            identity.trust_status,
            identity.domain_files,
            self._domains_changed,
            lambda: access.foreign_domains | connections.domains,
            lock,
        )
        self._renewals = renewals.Renewals(access)
        self._renewed = connections.renewed = RenewedGrants(access)
        self._identity_renewal = renewals.IdentityRenewal(
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
            identity.name, self._delivery, hooks.dial_watch, lambda: self.session.is_open, identity.master
        )
        self.tasks = TaskSet(self._crashed)  # a crash of one of them ends everything
        self._has_crashed = False
        self._domains_are_new = False
        self.rights_version = 0  # incremented for new grants and lists: what was refused may be tried again

    def start(self, opening: Callable[[], Awaitable[None]] | None = None) -> None:
        """Start the session (which `opening` opens, unless it is open), the watchdog, and maintenance."""

        async def run_session() -> None:
            if opening is not None:
                await opening()
            await self.session.run()

        name = self._identity.name
        # Tasks of their own: a master that hangs delays nothing that cuts connections.
        watchdog = ConnectionWatchdog(self._connections, self._access.expire_confirmation)
        self.tasks.spawn(watchdog.run(), f"{name}: watchdog")
        self.tasks.spawn(run_session(), f"{name}: master session")
        self.tasks.spawn(self._maintain(), f"{name}: maintenance")
        self.tasks.spawn(self._watch.run(), f"{name}: waiting for grants")

    async def close(self) -> None:
        await self.tasks.close()
        await self.session.close()

    def update_revocations(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take a newer list (empty: the one held) and a timestamp, then close what they end."""
        now, before = clock.now(), self._identity.revocations.data
        is_refused = True
        try:
            self._access.update_revocations(
                revocations, timestamp, master, now, self._identity.home.save_revocations
            )
            is_refused = False
        finally:  # the list takes effect even when the timestamp is refused
            # A timestamp alone ends nothing, and neither does a list for which all was cut before: here, not
            # only put in force, which another thread or another node with the same list may just have done.
            data = self._identity.revocations.data
            if is_refused or data != self._cut_for:
                self._connections.cut_ended(now)
                self._cut_for = data
            if data != before:
                self.rights_version += 1

    def take_push(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        """Take what the master pushes, one of `SIGNED_UPDATES`; `params` without the caller_id."""
        match method, params:
            case names.REVOCATION_UPDATE, (bytes() as revocations, bytes() as timestamp):
                self.update_revocations(revocations, timestamp, master)
            case names.DOMAINS_UPDATE, (bytes() as data,):
                self.domains.take_domains(data)
            case names.FOREIGN_UPDATE, (str() as domain, bytes() as data, bytes() as stamp, list() as chain):
                self.domains.take_foreign(domain, data, stamp, chain)
            case _:
                raise RossecError(f"{method} has other parameters")

    def _domains_changed(self, is_new: bool) -> None:
        self._connections.cut_ended(clock.now())
        if is_new:
            self.rights_version += 1
            self._domains_are_new = True

    async def _restore(self, session: MasterSession) -> None:
        # What is held is presented before anything is fetched: calls of the program go on meanwhile.
        self._grace.session_opened()
        with contextlib.suppress(AnswerRefused):  # requested again later
            if await renewals.renew(session.call, self._renewals, clock.now()):
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
        new = self._delivery.take_new()
        if from_directory:
            new += self._grant_directory.take_new()
        if new:
            _log.info("%s: %d new grants", self._identity.name, len(new))
            self.rights_version += 1
        return new

    async def _update(self, new: list[bytes]) -> None:
        call = self.session.call
        await self.domains.fetch_wanted(call)
        new = self._presentable(new)
        await self._present(new)
        renewed = await renewals.renew(call, self._renewals, clock.now())
        if renewed:
            self.rights_version += 1
        if new or renewed:
            await self._hooks.rights_changed()
        await renewals.renew_identity(call, self._identity_renewal, clock.now())
        if await prove(call, self._access):
            self._connections.cut_ended(clock.now())

    def _presentable(self, new: list[bytes]) -> list[bytes]:
        # `new` grants, or all: those of a domain count only once it is listed.
        if not self._domains_are_new:
            return new
        self._domains_are_new = False
        return self._access.current(clock.now())[:MAX_CALL]

    async def _present(self, new: list[bytes]) -> None:
        for batch in batches(new):
            await self.session.call(names.PRESENT_GRANTS, batch)

    def _crashed(self, error: BaseException) -> None:
        if not self._has_crashed:
            self._has_crashed = True
            self._hooks.crashed(error)
