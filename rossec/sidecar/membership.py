"""The master session of one identity, with revocation data, grants and renewal.

A shell around the parts that the built-in node uses too. Programs need not handle a restarted
master, a new grant, a renewed identity, or a topic that they may subscribe to again.
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
from rossec.sidecar.core import registrations
from rossec.sidecar.core.layers import AgentState, Layer
from rossec.sidecar.core.resubscribe import ResubscribeQueue
from rossec.sidecar.executor import AgentServices, CommandExecutor

_MAX_PRESENTED: Final = 64
_PERIOD: Final = 1.0

_log = logging.getLogger("rossec.sidecar")


class Membership:
    """Keeps one identity connected to the master.

    Args:
        services: the services of its agent.
        revocations: the revocation list, with the newest saved one.
        dial: connects to the master.
        close_terminated: closes the connections that revocation data no longer allows at a time.
    """

    def __init__(
        self,
        services: AgentServices,
        home: NodeHome,
        agent: AgentState,
        credentials: LiveCredentials,
        revocations: Revocations,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        close_terminated: Callable[[int], None],
    ) -> None:
        self._services = services
        self._home = home
        self._agent = agent
        self._revocations = revocations
        self._close_terminated = close_terminated
        self._grant_directory = GrantDirectory(home, agent.access)
        self._grant_directory.take_new()
        self._session = MasterSession(
            home.name,
            dial,
            self.on_revocations,
            self._restore,
            lambda: revocations.data,
            lambda call: prove(call, revocations),
        )
        self._renewals = Renewals(agent.access)
        self._identity_renewal = IdentityRenewal(home, credentials, clock.now())
        self._to_resubscribe = ResubscribeQueue()
        self._tasks = TaskSet()

    async def start(self) -> str:
        """Open the session and keep it open; returns the local address of the connection.

        Raises:
            HangUp: the master is unreachable; programs then try again, as in ROS.
        """
        name = self._home.name
        try:
            stream = await self._session.open()
        except (HintedError, OSError, TimeoutError) as error:
            _log.warning("%s: the master does not answer: %s", name, error)
            raise HangUp(str(error)) from error
        self._tasks.spawn(self._session.run(), f"{name}: master session")
        self._tasks.spawn(self._collect_grants(), f"{name}: grants")
        self._tasks.spawn(self._resubscribe_topics(), f"{name}: resubscribe")
        return stream.local_address

    async def close(self) -> None:
        """End the session."""
        await self._tasks.close()
        await self._session.close()

    async def call_master(self, method: str, params: tuple[object, ...]) -> object:
        """The master's answer; refusals are logged, since a program may not print them."""
        answer = await self._session.forward(method, *params)
        match answer:
            case [code, str(status), *_] if code != 1 and status.startswith("rossec: "):
                _log.warning("the master refuses %s: %s", method, status.removeprefix("rossec: "))
            case _:
                pass
        return answer

    def on_revocations(self, data: bytes, timestamp: bytes, master: Identity) -> None:
        """Store a newer list and a fresh timestamp, then close connections that they end."""
        now = clock.now()
        try:
            access, save = self._agent.access, self._home.save_revocations
            access.update_revocations(data, timestamp, master, now, save)
        finally:  # revoked connections are closed even if the timestamp is invalid
            self._close_terminated(now)

    def on_topic_ended(self, topic: str, began: float) -> None:
        """A connection for `topic`, made at `began` of the monotonic clock, has ended."""
        self._to_resubscribe.add(topic, began, time.monotonic())
        if not self._may_subscribe(topic):
            _log.warning("%s: no grant for subscribe on %s any more", self._home.name, topic)

    def _may_subscribe(self, topic: str) -> bool:
        return self._agent.access.holds(Right.SUBSCRIBE, topic, clock.now())

    async def _restore(self, session: MasterSession) -> None:
        self._agent.publisher_grace.session_opened()
        with contextlib.suppress(AnswerRefused):  # tried again later
            await renew(session.call, self._renewals, clock.now())
        current = self._agent.access.current(clock.now())
        await session.call("rossec.presentGrants", current[:_MAX_PRESENTED])
        await self._run(registrations.restore(self._agent))

    async def _collect_grants(self) -> None:
        while True:
            await asyncio.sleep(_PERIOD)
            new = self._grant_directory.take_new()
            with contextlib.suppress(HintedError, OSError):  # else on reconnect
                if new:
                    await self._session.call("rossec.presentGrants", new)
                await renew(self._session.call, self._renewals, clock.now())
                await renew_identity(self._session.call, self._identity_renewal, clock.now())
                if await prove(self._session.call, self._revocations):
                    self._close_terminated(clock.now())

    async def _resubscribe_topics(self) -> None:
        while True:
            await asyncio.sleep(_PERIOD)
            await self._run_logged(
                "expired publishers", registrations.drop_expired_publishers(self._agent)
            )
            for topic in self._to_resubscribe.take_due(time.monotonic(), self._may_subscribe):
                await self._run_logged(topic, registrations.resubscribe(self._agent, topic))

    async def _run_logged(self, subject: str, layer: Layer[None]) -> None:
        try:
            await self._run(layer)
        except (HintedError, OSError, Fault) as error:
            _log.info("%s: cannot subscribe again: %s: %s", self._home.name, subject, error)

    async def _run(self, layer: Layer[None]) -> None:
        executor = CommandExecutor(self._services)
        try:
            await executor.run(layer)
        finally:
            await executor.close()
