"""Following one other master: dial, check who it is, take over what it says. A shell.

What happens is decided by `site_state`; the facts are in the import layer of the own master. The
site is asked, and never calls: no address of this master is needed there. Lists of revocations and
domains are compared with every answer, and settled before more facts are asked for. A site behind a
relay is reached by its forwarded ports; the relay is another process, so each is waited for, and
not long.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Callable, Collection, Iterable
from functools import partial
from secrets import SystemRandom
from typing import Any, Final

from ca.certificates import Identity
from ca.errors import CAError, HintedError, RevocationsStale
from ca.names import shown, split_alias
from rossec import errors, peer_limits
from rossec.federation import exchange, site_state
from rossec.federation.exchange import LONGEST_FOREIGN, ForeignLists, Mirroring, OwnMaster
from rossec.federation.settings import SiteSettings
from rossec.master.state.forwarded_ports import MASTER, MAX_FORWARDED_PORTS, ForwardedPorts, Target
from rossec.net.aio import SecureStream, WireProtocol, connect
from rossec.net.rpc import RpcClient
from rossec.ros import names, xmlrpc

FORWARDED_PORT_WAIT: Final = (
    5.0  # seconds for the master's forwarded port: a relay that polls opens it at once
)
NODES_WAIT: Final = 1.0  # seconds for those of new nodes; they are shown without others after it
NO_CHANGE: Final = site_state.SiteChange(frozenset(), frozenset(), False, b"", b"")
_log = logging.getLogger("rossec.federation")


class SitePorts:
    """The forwarded ports of one site; `on_forwarded_port` is called when its master's was opened."""

    def __init__(
        self, forwarded_ports: ForwardedPorts, settings: SiteSettings, on_forwarded_port: Callable[[], None]
    ) -> None:
        self._forwarded_ports = forwarded_ports
        self._settings = settings
        self._on_forwarded_port = on_forwarded_port
        self._master = Target(settings.via, MASTER, settings.master)
        self._facts = site_state.ForwardedPortFacts(settings.via, forwarded_ports.forwarded_port)
        self._had_forwarded_port = False
        self._missing = 0
        self.changed: Final = asyncio.Event()
        forwarded_ports.listen(settings.label, self._note)

    async def address(self) -> tuple[str, int]:
        self._want(self._facts.targets)
        await self._wait([self._master], FORWARDED_PORT_WAIT)
        forwarded_port = self._forwarded_ports.forwarded_port(self._master)
        if forwarded_port is not None:
            return forwarded_port
        if self._forwarded_ports.way(self._settings.via) is None:
            raise errors.RelayRefused(
                f"no relay of this site knows a peer {self._settings.via}",
                f"is `rossec relay` running, and was this done: rossec relay add {self._settings.via} FILE",
            )
        raise errors.RelayRefused(
            f"the relay opens no forwarded port for {self._settings.master} of {self._settings.via}",
            "rossec relay status",
        )

    async def take(self, change: site_state.SiteChange) -> site_state.SiteChange:
        before = self._facts.targets
        for _ in self._facts.take(change):
            await asyncio.sleep(0)
        targets = self._facts.targets
        self._want(targets)
        await self._wait(targets - before, NODES_WAIT)
        return self.refreshed(change)

    def refreshed(self, change: site_state.SiteChange = NO_CHANGE) -> site_state.SiteChange:
        self.changed.clear()
        return self._facts.shown(change)

    def drop(self) -> None:
        self._facts.forget()
        self._want(())

    def close(self) -> None:
        self._forwarded_ports.forget(self._settings.label)

    def status(self) -> dict[str, Any]:
        found = self._forwarded_ports.way(self._settings.via)
        if found is None:
            return {}
        return {"relay": found[0], **found[1]._asdict()}

    def _want(self, targets: Collection[Target]) -> None:
        missing = self._forwarded_ports.want(self._settings.label, {self._master, *targets})
        if missing and not self._missing:
            _log.warning(
                "site %s: %d nodes and services have no address here: a site has half of %d forwarded ports",
                self._settings.label,
                missing,
                MAX_FORWARDED_PORTS,
            )
        self._missing = missing

    async def _wait(self, targets: Collection[Target], longest: float) -> None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                while any(self._forwarded_ports.forwarded_port(target) is None for target in targets):
                    self.changed.clear()
                    await self.changed.wait()
        self.changed.set()  # it was not looked at what else has changed

    def _note(self) -> None:
        self.changed.set()
        has_forwarded_port = self._forwarded_ports.forwarded_port(self._master) is not None
        if has_forwarded_port and not self._had_forwarded_port:
            self._on_forwarded_port()
        self._had_forwarded_port = has_forwarded_port


_DIAL: Final = 5.0
_DIAL_VIA: Final = 15.0  # the relay may have to dial its peer first


class SiteConnections:
    """Connects with one site; `forwarded_ports`: of the site, if it is reached by a relay."""

    def __init__(self, settings: SiteSettings, own: OwnMaster, forwarded_ports: SitePorts | None) -> None:
        self._settings = settings
        self._own = own
        self._forwarded_ports = forwarded_ports

    @contextlib.asynccontextmanager
    async def open(self) -> AsyncIterator[tuple[RpcClient, Identity]]:
        async with asyncio.timeout(_DIAL if self._forwarded_ports is None else _DIAL_VIA):
            forwarded_ports, settings = self._forwarded_ports, self._settings
            address = settings.address if forwarded_ports is None else await forwarded_ports.address()
            stream = await connect(*address, self._own.context, WireProtocol.HTTP)
        try:
            self._check(stream)
            yield RpcClient(stream, deadline=site_state.SILENCE), stream.peer
        finally:
            await stream.close()

    def check_trust(self, peer: Identity) -> None:
        try:
            self._own.state.trust.caller(peer, self._own.state.now())
        except RevocationsStale:  # of its domain: it is asked for them
            return
        except CAError as error:
            raise errors.SiteRefused(f"{shown(peer.name)}: {error}", error.hint) from error

    def _check(self, stream: SecureStream[Identity]) -> None:
        # The peer is the master that is followed, and not revoked.
        peer, expected = stream.peer, self._settings
        alias = split_alias(peer.name) if peer.is_foreign else None
        label, name = ("", peer.name) if alias is None else alias
        if (label, name) != (expected.domain, expected.master):
            stream.abort("not the master that is followed")
            raise errors.SiteRefused(
                f"{shown(peer.name)} answers {expected.place}, not {expected.master}"
                + (f" of {expected.domain}" if expected.domain else ""),
                "check the address: rossec federation list",
            )
        self.check_trust(peer)


PACE: Final = 0.05  # seconds between two questions: a site may answer at once, without end
_audit = logging.getLogger("rossec.audit")

_RANDOM: Final = SystemRandom().random
_AT_FORWARDED_PORT: Final = (
    errors.ChannelClosed,
    errors.HandshakeFailed,
    errors.PeerUnreachable,
)  # of a relay without a link
Failures: Final = (HintedError, OSError, TimeoutError, xmlrpc.Fault)


class FollowedSite:
    """Follows one site until it is removed; `rand` returns a random number from 0 up to 1."""

    def __init__(self, settings: SiteSettings, own: OwnMaster, rand: Callable[[], float] = _RANDOM) -> None:
        self.settings: Final = settings
        self.state: Final = site_state.SiteState()
        self.error = self.hint = ""  # why it is not followed now; empty: it is
        self._own = own
        self._rand = rand
        self._cursor = site_state.SiteCursor()
        self._asked_at = 0.0
        self._mirroring = Mirroring(own, settings)
        self._woken = asyncio.Event()
        self._lists_changed = asyncio.Event()
        self._foreign = ForeignLists(own, settings.domain) if settings.domain else None
        forwarded_ports = SitePorts(own.state.forwarded_ports, settings, self.wake) if settings.via else None
        self._forwarded_ports = forwarded_ports
        self.connections: Final = SiteConnections(settings, own, forwarded_ports)

    async def run(self) -> None:
        while True:
            self._take(site_state.SiteEvent.DUE)
            try:
                await self._follow()
            except (errors.SiteRefused, errors.IdentityRefused) as error:
                self._report(site_state.SiteEvent.REFUSED, error)
            except Failures as error:
                self._report(site_state.SiteEvent.FAILED, error)
            except Exception as error:  # noqa: BLE001 - no answer may end that it is followed
                _log.exception("following site %s failed", self.settings.label)
                self._report(site_state.SiteEvent.FAILED, error)
            if self.state.phase not in (site_state.SitePhase.FOLLOWING, site_state.SitePhase.LISTENING):
                self._woken.clear()
                with contextlib.suppress(TimeoutError):
                    longest = site_state.LONGEST_PAUSE if self._foreign is None else LONGEST_FOREIGN
                    async with asyncio.timeout(self.state.pause(self._rand(), longest)):
                        await self._woken.wait()

    def tick(self) -> None:
        if self.state.has_expired(time.monotonic()):
            self._take(site_state.SiteEvent.EXPIRED)
            _audit.warning("site %s is lost: its facts are dropped", self.settings.label)

    def wake(self) -> None:
        self._woken.set()

    def remove(self) -> None:
        self._take(site_state.SiteEvent.REMOVED)
        if self._forwarded_ports is not None:
            self._forwarded_ports.close()

    async def send_lists(self) -> None:
        # The connection on which it is followed waits for an answer, so another one is made.
        self._lists_changed.set()
        self._mirroring.judge()
        if self.settings.domain or self.state.phase is not site_state.SitePhase.FOLLOWING:
            return
        with contextlib.suppress(*Failures):  # else with the next answer
            async with self.connections.open() as (client, peer):
                await exchange.settle(client, self._own, peer)

    def status(self) -> dict[str, Any]:
        found = site_state.site_status(self.settings, self.state, self._own.state.imports, time.monotonic())
        return {
            **found,
            "version": self._cursor.version,
            "error": self.error,
            "hint": self.hint,
            "mirrored": self._mirroring.mirrored,
            "way": {} if self._forwarded_ports is None else self._forwarded_ports.status(),
        }

    async def _follow(self) -> None:
        was_followed = self.state.failures == 0 and self._cursor.instance != ""
        async with self.connections.open() as (client, peer):
            self._take(site_state.SiteEvent.CONNECTED)
            self._cursor.reconnected()
            if not was_followed:
                if self._foreign is not None:
                    await self._foreign.greet(client, peer)
                else:
                    # Who mirrors parameters shows its grants: they decide what it may read.
                    tokens = self._own.grants() if self.settings.parameters else ()
                    if tokens := list(tokens)[: exchange.MAX_PRESENTED]:
                        await client.ask(names.PRESENT_GRANTS, self._own.name, tokens)
                    await exchange.settle(client, self._own, peer)
            try:
                await self._poll(client, peer)
            except errors.GraphHidden as error:
                if self._foreign is None or self._foreign.may_see(peer.certified_name):
                    raise errors.SiteRefused(str(error), error.hint) from error  # tried again
                self._report(site_state.SiteEvent.HIDDEN, error)
                check = partial(self.connections.check_trust, peer)
                await self._foreign.listen(client, peer, self._lists_changed, check)

    async def _poll(self, client: RpcClient, peer: Identity) -> None:
        while True:
            await self._pace()
            # Before the question: what is wanted meanwhile is not in it, and is asked for by the next one.
            demand = self._own.state.imports.demand.version
            asking = asyncio.ensure_future(self._next_change(client))
            try:
                if not await self._is_answered(asking, peer, demand):
                    return
                change = asking.result()
            finally:
                asking.cancel()
            await self._take_over(change)
            self._own.state.imports.settle(self.settings.label, demand)
            if self._foreign is not None:
                await self._foreign.keep_fresh(client, peer, change.revocations)
            else:
                await exchange.settle(client, self._own, peer, change)
            try:
                await self._mirroring.keep(client)
            except (errors.AnswerRefused, errors.ImportRefused) as error:
                self.error, self.hint = peer_limits.printable(str(error)), peer_limits.printable(error.hint)

    async def _pace(self) -> None:
        await asyncio.sleep(self._asked_at + PACE - time.monotonic())
        self._asked_at = time.monotonic()

    async def _is_answered(
        self, asking: asyncio.Future[site_state.SiteChange], peer: Identity, demand: int
    ) -> bool:
        imports, changes = self._own.state.imports, self._own.state.demand_changes
        events = [
            self._lists_changed,
            *([] if self._forwarded_ports is None else [self._forwarded_ports.changed]),
        ]
        while not asking.done():
            # The site holds the question until something changes there: what is wanted here would wait.
            if self.state.phase is site_state.SitePhase.FOLLOWING and imports.demand.version != demand:
                return False
            if self._lists_changed.is_set():
                self._lists_changed.clear()  # the peer itself may be revoked by the new list
                self.connections.check_trust(peer)
            if self._forwarded_ports is not None and self._forwarded_ports.changed.is_set():
                await self._apply(self._forwarded_ports.refreshed())
            others: list[asyncio.Future[Any]] = [
                asyncio.ensure_future(changes.wait(site_state.SILENCE)),
                *(asyncio.ensure_future(event.wait()) for event in events),
            ]
            try:
                await asyncio.wait([asking, *others], return_when=asyncio.FIRST_COMPLETED)
            finally:
                for each in others:
                    each.cancel()
        return True

    async def _next_change(self, client: RpcClient) -> site_state.SiteChange:
        imports = self._own.state.imports
        wanted = imports.demand.wanted(self.settings.site, self._own.state.now())
        while True:
            try:
                answer = await client.ask(site_state.METHOD, self._own.name, *self._cursor.params, [*wanted])
            except errors.AnswerRefused as error:
                raise errors.GraphHidden(f"{self.settings.label} refuses: {error}", error.hint) from error
            change = self._cursor.take(answer)
            if change is not None:  # else a part of a graph that comes in several answers
                return change
            await self._pace()

    async def _take_over(self, change: site_state.SiteChange) -> None:
        try:
            change = change if self._forwarded_ports is None else await self._forwarded_ports.take(change)
        except errors.ImportRefused as error:
            raise errors.SiteRefused(f"facts of {self.settings.label}: {error}", error.hint) from error
        await self._apply(change)
        if self.state.phase is not site_state.SitePhase.FOLLOWING:
            _audit.info("site %s is followed", self.settings.label)
        self._take(site_state.SiteEvent.ANSWERED)
        self.error = self.hint = ""

    async def _apply(self, change: site_state.SiteChange) -> None:
        steps = self._own.state.imports.apply_in_steps(
            self.settings.site, change.added, change.removed, whole=change.whole
        )
        try:
            events = await exchange.in_turns(steps)
        except HintedError as error:
            raise errors.SiteRefused(f"facts of {self.settings.label}: {error}", error.hint) from error
        self._deliver(events)

    def _report(self, event: site_state.SiteEvent, error: BaseException) -> None:
        text = peer_limits.printable(str(error)) or type(error).__name__
        if text != self.error:
            _log.warning("site %s: %s", self.settings.label, text)
        if event is not site_state.SiteEvent.FAILED and text != self.error:
            _audit.warning("site %s is not followed: %s", self.settings.label, text)
        self.error, self.hint = text, peer_limits.printable(self._advice(error))
        self._take(event)

    def _advice(self, error: BaseException) -> str:
        # The hint of a failure; a stranger is not told why it is refused, but can guess.
        if self._forwarded_ports is not None and isinstance(error, _AT_FORWARDED_PORT):
            return "is there a link? rossec relay status"
        if isinstance(error, errors.PeerRefused) and self._foreign is not None:
            return f"does {self.settings.domain} trust this domain? there: rossec domain list"
        return error.hint if isinstance(error, HintedError) else ""

    def _take(self, event: site_state.SiteEvent) -> None:
        label = self.settings.label
        match self.state.take(event, time.monotonic()):
            case site_state.SiteEffect.NONE:
                pass
            case site_state.SiteEffect.MARK:
                self._own.state.imports.lose(label)
            case site_state.SiteEffect.EXPIRE:
                self._begin_again()
                self._own.state.imports.expire(label)
                self._own.state.notify()
            case site_state.SiteEffect.DROP:
                self._begin_again()
                self._deliver(self._own.state.imports.drop(label))
                self._mirroring.drop()

    def _begin_again(self) -> None:
        self._cursor = site_state.SiteCursor()
        if self._forwarded_ports is not None:
            self._forwarded_ports.drop()

    def _deliver(self, events: Iterable[Any]) -> None:
        for event in events:
            self._own.effects.deliver(event)
        self._own.state.notify()
