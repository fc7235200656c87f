"""The standing of one identity with the master: its session, revocations, grants and their renewal.

A shell, of the parts of the built-in node. The programs need not notice a restarted master, a new
grant, a renewed identity, or that a topic they lost is open to them again.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Final

from ca.certificates import Identity
from ca.errors import HintedError
from ca.revocation.state import Revocations
from grants.model import Right
from rossec import clock
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.errors import AnswerRefused, HangUp
from rossec.home import NodeHome
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.grant_renewal import Renewals, renew
from rossec.participant.identity_renewal import IdentityRenewal, renew_identity
from rossec.participant.master_session import MasterSession
from rossec.participant.revocation_proofs import prove
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.core import master_calls
from rossec.sidecar.core.layers import AgentState, Layer
from rossec.sidecar.core.resubscribe import ResubscribeQueue
from rossec.sidecar.executor import AgentServices, CommandExecutor

_PRESENTED: Final = 64
_COLLECT: Final = 1.0

_log = logging.getLogger("rossec.sidecar")


class Membership:
    """One identity's.

    Args:
        house: whom visits are made for.
        revocations: the list it holds, already with the newest one that was saved.
        dial: connects to the master.
        cut: ends at a time what the revocations do not allow any more.
    """

    def __init__(
        self,
        house: AgentServices,
        home: NodeHome,
        tenant: AgentState,
        credentials: LiveCredentials,
        revocations: Revocations,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        cut: Callable[[int], None],
    ) -> None:
        self._house = house
        self._home = home
        self._tenant = tenant
        self._revocations = revocations
        self._cut = cut
        self._shelf = GrantDirectory(home, tenant.access)
        self._shelf.take_new()
        self._session = MasterSession(
            home.name,
            dial,
            self.revocations_arrived,
            self._restore,
            lambda: revocations.data,
            lambda call: prove(call, revocations),
        )
        self._renewals = Renewals(tenant.access)
        self._identity_renewal = IdentityRenewal(home, credentials, clock.now())
        self._lost = ResubscribeQueue()
        self._tasks = TaskSet()

    async def begin(self) -> str:
        """Meet the master and keep in touch; the address of this host it was met from.

        Raises:
            HangUp: it is not there; a program then tries again, as in ROS.
        """
        name = self._home.name
        try:
            stream = await self._session.open()
        except (HintedError, OSError, TimeoutError) as error:
            _log.warning("%s: the master does not answer: %s", name, error)
            raise HangUp(str(error)) from error
        self._tasks.spawn(self._session.run(), f"{name}: master session")
        self._tasks.spawn(self._collect_grants(), f"{name}: grants")
        self._tasks.spawn(self._return_to_topics(), f"{name}: lost topics")
        return stream.local_address

    async def close(self) -> None:
        """End the session."""
        await self._tasks.close()
        await self._session.close()

    async def forward(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer; a program that is refused may not show why."""
        answer = await self._session.forward(method, *params)
        match answer:
            case [code, str(status), *_] if code != 1 and status.startswith("rossec: "):
                _log.warning("the master refuses %s: %s", method, status.removeprefix("rossec: "))
            case _:
                pass
        return answer

    def revocations_arrived(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        """Take over a newer list and a fresh timestamp, then cut what they end."""
        now = clock.now()
        try:
            access, save = self._tenant.access, self._home.save_revocations
            access.update_revocations(data, timestamp, master, now, save)
        finally:  # what the list revokes ends, whatever is wrong with the timestamp
            self._cut(now)

    def topic_ended(self, topic: str, began: float) -> None:
        """A connection for `topic`, made at `began` of the monotonic clock, has ended."""
        self._lost.add(topic, began, time.monotonic())
        if not self._may_subscribe(topic):
            _log.warning("%s: no grant for subscribe on %s any more", self._home.name, topic)

    def _may_subscribe(self, topic: str) -> bool:
        return self._tenant.access.holds(Right.SUBSCRIBE, topic, clock.now())

    async def _restore(self, session: MasterSession) -> None:
        self._tenant.named.session_opened()
        with contextlib.suppress(AnswerRefused):  # what is not renewed now is asked for later
            await renew(session.call, self._renewals, clock.now())
        current = self._tenant.access.current(clock.now())
        await session.call("rossec.presentGrants", current[:_PRESENTED])
        await self._visit(master_calls.restore(self._tenant))

    async def _collect_grants(self) -> None:
        while True:
            await asyncio.sleep(_COLLECT)
            new = self._shelf.take_new()
            with contextlib.suppress(HintedError, OSError):  # else with the next connection
                if new:
                    await self._session.call("rossec.presentGrants", new)
                await renew(self._session.call, self._renewals, clock.now())
                await renew_identity(self._session.call, self._identity_renewal, clock.now())
                if await prove(self._session.call, self._revocations):
                    self._cut(clock.now())

    async def _return_to_topics(self) -> None:
        while True:
            await asyncio.sleep(_COLLECT)
            await self._try("publishers that are gone", master_calls.let_go(self._tenant))
            for topic in self._lost.take_due(time.monotonic(), self._may_subscribe):
                await self._try(topic, master_calls.resubscribe(self._tenant, topic))

    async def _try(self, about: str, layer: Layer[None]) -> None:
        try:
            await self._visit(layer)
        except (HintedError, OSError, Fault) as error:
            _log.info("%s: cannot subscribe again: %s: %s", self._home.name, about, error)

    async def _visit(self, layer: Layer[None]) -> None:
        visit = CommandExecutor(self._house)
        try:
            await visit.run(layer)
        finally:
            await visit.close()
