"""Following one other master: dial, check who it is, take over what it says. A shell.

What happens is decided by `states`, what an answer means by `answers`; the facts are in the import
layer of the own master. The site is asked, and never calls: no address of this master is needed
there. Lists of revocations and domains are compared with every answer, and settled before more
facts are asked for.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Iterable
from functools import partial
from secrets import SystemRandom
from typing import Any, Final

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.errors import (
    AnswerRefused,
    ChannelClosed,
    GraphHidden,
    HandshakeFailed,
    IdentityRefused,
    ImportRefused,
    PeerRefused,
    PeerUnreachable,
    SiteRefused,
)
from rossec.federation import exchange
from rossec.federation.answers import METHOD, SiteChange, SiteCursor
from rossec.federation.foreign import LONGEST_FOREIGN, ForeignLists
from rossec.federation.mirroring import Mirroring
from rossec.federation.own import OwnMaster
from rossec.federation.settings import SiteSettings
from rossec.federation.site_connection import SiteConnections
from rossec.federation.site_status import site_status
from rossec.federation.states import LONGEST_PAUSE, SILENCE, Effect, Event, Phase, SiteState
from rossec.federation.via import SiteDoors
from rossec.net.rpc.client import RpcClient
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

_DIAL: Final = 5.0
PACE: Final = 0.05  # seconds between two questions: a site may answer at once, without end
_log = logging.getLogger("rossec.federation")
_audit = logging.getLogger("rossec.audit")

_RANDOM: Final = SystemRandom().random
_AT_DOOR: Final = (ChannelClosed, HandshakeFailed, PeerUnreachable)  # of a relay without a link
Failures: Final = (HintedError, OSError, TimeoutError, Fault)


class FollowedSite:
    """Follows one site until `close`.

    Args:
        settings: the site.
        own: the master that follows.
        rand: returns a random number from 0 up to 1.

    Attributes:
        state: where it is.
        error: why it is not followed now; empty: it is.
        hint: what may be done about it, or empty.
        connections: with the site.
    """

    def __init__(
        self,
        settings: SiteSettings,
        own: OwnMaster,
        rand: Callable[[], float] = _RANDOM,
    ) -> None:
        self.settings: Final = settings
        self.state: Final = SiteState()
        self.error = self.hint = ""
        self._own = own
        self._rand = rand
        self._cursor = SiteCursor()
        self._asked_at = 0.0
        self._mirroring = Mirroring(own, settings)
        self._woken = asyncio.Event()
        self._lists_changed = asyncio.Event()
        self._foreign = ForeignLists(own, settings.domain) if settings.domain else None
        doors = SiteDoors(own.state.doors, settings, self.wake) if settings.via else None
        self._doors = doors
        self.connections: Final = SiteConnections(settings, own, doors)

    async def run(self) -> None:
        """Follow until cancelled; a failure is tried again."""
        while True:
            self._take(Event.DUE)
            try:
                await self._follow()
            except (SiteRefused, IdentityRefused) as error:
                self._report(Event.REFUSED, error)
            except Failures as error:
                self._report(Event.FAILED, error)
            except Exception as error:  # noqa: BLE001 - no answer may end that it is followed
                _log.exception("following site %s failed", self.settings.label)
                self._report(Event.FAILED, error)
            if self.state.phase not in (Phase.FOLLOWING, Phase.LISTENING):
                await self._pause()

    def tick(self) -> None:
        """Let the facts go that are too old; called once in a second."""
        if self.state.has_expired(time.monotonic()):
            self._take(Event.EXPIRED)
            _audit.warning("site %s is lost: its facts are dropped", self.settings.label)

    def wake(self) -> None:
        """Dial now, if it is waiting: the site seems to be there again."""
        self._woken.set()

    def remove(self) -> None:
        """It is followed no longer; `run` has been cancelled."""
        self._take(Event.REMOVED)
        if self._doors is not None:
            self._doors.close()

    async def send_lists(self) -> None:
        """The own lists have changed: judge the site again, and send it the newer list at once.

        The connection on which it is followed waits for an answer, so another one is made.
        """
        self._lists_changed.set()
        self._mirroring.judge()
        if self.settings.domain or self.state.phase is not Phase.FOLLOWING:
            return
        with contextlib.suppress(*Failures):  # else with the next answer
            async with self.connections.open() as (client, peer):
                await exchange.settle(client, self._own, peer)

    def status(self) -> dict[str, Any]:
        """The site for people and programs."""
        found = site_status(self.settings, self.state, self._own.state.imports, time.monotonic())
        return {
            **found,
            "version": self._cursor.version,
            "error": self.error,
            "hint": self.hint,
            "mirrored": self._mirroring.mirrored,
            "way": {} if self._doors is None else self._doors.status(),
        }

    async def _follow(self) -> None:
        """Follow on one connection, until it is to be asked for more."""
        was_followed = self.state.failures == 0 and self._cursor.instance != ""
        async with self.connections.open() as (client, peer):
            self._take(Event.CONNECTED)
            self._cursor.reconnected()
            if not was_followed:
                await self._greet(client, peer)
            try:
                await self._poll(client, peer)
            except GraphHidden as error:
                if self._foreign is None or self._foreign.may_see(peer.certified_name):
                    raise SiteRefused(str(error), error.hint) from error  # tried again
                self._report(Event.HIDDEN, error)
                check = partial(self.connections.check_trust, peer)
                await self._foreign.listen(client, peer, self._lists_changed, check)

    async def _poll(self, client: RpcClient, peer: Identity) -> None:
        """Take over what it answers, until local nodes want more."""
        while True:
            await self._pace()
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
            await self._exchange(client, peer, change)
            await self._mirror(client)

    async def _pace(self) -> None:
        """Let a moment pass between two questions, whatever the site or local nodes do."""
        await asyncio.sleep(self._asked_at + PACE - time.monotonic())
        self._asked_at = time.monotonic()

    async def _is_answered(
        self, asking: asyncio.Future[SiteChange], peer: Identity, demand: int
    ) -> bool:
        """Wait for an answer; False: local nodes want more meanwhile.

        Raises:
            SiteRefused: a new list revokes the site, or ends the trust in its domain.
        """
        imports, changes = self._own.state.imports, self._own.state.demand_changes
        while not asking.done():
            if self.state.phase is Phase.FOLLOWING and imports.demand.version != demand:
                return False
            if self._lists_changed.is_set():
                self._lists_changed.clear()
                self.connections.check_trust(peer)
            if self._doors is not None and self._doors.changed.is_set():
                await self._apply(self._doors.refreshed())
            others: list[asyncio.Future[Any]] = [
                asyncio.ensure_future(changes.wait(SILENCE)),
                *(asyncio.ensure_future(event.wait()) for event in self._events),
            ]
            try:
                await asyncio.wait([asking, *others], return_when=asyncio.FIRST_COMPLETED)
            finally:
                for each in others:
                    each.cancel()
        return True

    async def _mirror(self, client: RpcClient) -> None:
        try:
            await self._mirroring.keep(client)
        except (AnswerRefused, ImportRefused) as error:
            self.error, self.hint = printable(str(error)), printable(error.hint)

    async def _greet(self, client: RpcClient, peer: Identity) -> None:
        """Settle the lists, and show what a foreign master wants to see."""
        if self._foreign is not None:
            await self._foreign.greet(client, peer)
        else:
            if self.settings.parameters:
                await exchange.present_own(client, self._own)
            await exchange.settle(client, self._own, peer)

    async def _exchange(self, client: RpcClient, peer: Identity, change: SiteChange) -> None:
        if self._foreign is not None:
            await self._foreign.keep_fresh(client, peer, change.revocations)
            return
        await exchange.settle(client, self._own, peer, change)

    async def _next_change(self, client: RpcClient) -> SiteChange:
        """The next complete answer."""
        imports = self._own.state.imports
        wanted = imports.demand.wanted(self.settings.site, self._own.state.now())
        while True:
            try:
                answer = await client.ask(METHOD, self._own.name, *self._cursor.params, [*wanted])
            except AnswerRefused as error:
                raise GraphHidden(f"{self.settings.label} refuses: {error}", error.hint) from error
            change = self._cursor.take(answer)
            if change is not None:
                return change
            await self._pace()

    @property
    def _events(self) -> list[asyncio.Event]:
        """What ends waiting for an answer, beside it and what local nodes want."""
        return [self._lists_changed, *([] if self._doors is None else [self._doors.changed])]

    async def _take_over(self, change: SiteChange) -> None:
        try:
            change = change if self._doors is None else await self._doors.take(change)
        except ImportRefused as error:
            raise SiteRefused(f"facts of {self.settings.label}: {error}", error.hint) from error
        await self._apply(change)
        if self.state.phase is not Phase.FOLLOWING:
            _audit.info("site %s is followed", self.settings.label)
        self._take(Event.ANSWERED)
        self.error = self.hint = ""

    async def _apply(self, change: SiteChange) -> None:
        """Let the import layer take a change over."""
        steps = self._own.state.imports.apply_in_steps(
            self.settings.site, change.added, change.removed, whole=change.whole
        )
        try:
            events = await exchange.in_turns(steps)
        except HintedError as error:
            raise SiteRefused(f"facts of {self.settings.label}: {error}", error.hint) from error
        self._deliver(events)

    def _report(self, event: Event, error: BaseException) -> None:
        text = printable(str(error)) or type(error).__name__
        if text != self.error:
            _log.warning("site %s: %s", self.settings.label, text)
        if event is not Event.FAILED and text != self.error:
            _audit.warning("site %s is not followed: %s", self.settings.label, text)
        self.error, self.hint = text, printable(self._advice(error))
        self._take(event)

    def _advice(self, error: BaseException) -> str:
        """The hint of a failure; a stranger is not told why it is refused, but can guess."""
        if self._doors is not None and isinstance(error, _AT_DOOR):
            return "is there a link? rossec relay status"
        if isinstance(error, PeerRefused) and self._foreign is not None:
            return f"does {self.settings.domain} trust this domain? there: rossec domain list"
        return error.hint if isinstance(error, HintedError) else ""

    def _take(self, event: Event) -> None:
        label = self.settings.label
        match self.state.take(event, time.monotonic()):
            case Effect.NONE:
                pass
            case Effect.MARK:
                self._own.state.imports.lose(label)
            case Effect.EXPIRE:
                self._begin_again()
                self._own.state.imports.expire(label)
                self._own.state.notify()
            case Effect.DROP:
                self._begin_again()
                self._deliver(self._own.state.imports.drop(label))
                self._mirroring.drop()

    def _begin_again(self) -> None:
        """The next answer has all facts."""
        self._cursor = SiteCursor()
        if self._doors is not None:
            self._doors.drop()

    def _deliver(self, events: Iterable[Any]) -> None:
        for event in events:
            self._own.effects.deliver(event)
        self._own.state.notify()

    async def _pause(self) -> None:
        """Wait to dial again; a foreign master that shows nothing still says what is revoked."""
        self._woken.clear()
        with contextlib.suppress(TimeoutError):
            longest = LONGEST_PAUSE if self._foreign is None else LONGEST_FOREIGN
            async with asyncio.timeout(self.state.pause(self._rand(), longest)):
                await self._woken.wait()
