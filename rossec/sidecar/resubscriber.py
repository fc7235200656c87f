"""Publisher updates for the programs of one identity where no master sends one.

A shell around `core.registrations`. Programs need not handle a topic whose connection ended and
that they may subscribe to again, or publishers that a restarted master did not list again.
"""

import asyncio
import logging
import time
from typing import Final

from ca.domains.aliases import shown
from ca.errors import HintedError
from grants.model import Right
from rossec import clock
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.core import registrations
from rossec.sidecar.core.layers import AgentState, Layer
from rossec.sidecar.core.resubscribe import ResubscribeQueue
from rossec.sidecar.executor import AgentServices, run_layer

_PERIOD: Final = 1.0

_log = logging.getLogger("rossec.sidecar")


class Resubscriber:
    """Resubscribes the programs of one identity."""

    def __init__(self, services: AgentServices, agent: AgentState) -> None:
        self._services = services
        self._agent = agent
        self._to_resubscribe = ResubscribeQueue()

    def on_topic_ended(self, topic: str, began: float) -> None:
        """A connection for `topic`, made at `began` of the monotonic clock, has ended."""
        self._to_resubscribe.add(topic, began, time.monotonic())
        name = shown(topic)
        if not self._may_subscribe(topic):
            _log.warning("%s: no grant for subscribe on %s any more", self._services.name, name)

    async def run(self) -> None:
        """Resubscribe periodically until cancelled."""
        while True:
            await asyncio.sleep(_PERIOD)
            await self._run_logged(
                "expired publishers", registrations.drop_expired_publishers(self._agent)
            )
            for topic in self._to_resubscribe.take_due(time.monotonic(), self._may_subscribe):
                await self._run_logged(topic, registrations.resubscribe(self._agent, topic))

    def _may_subscribe(self, topic: str) -> bool:
        return self._agent.access.holds(Right.SUBSCRIBE, topic, clock.now())

    async def _run_logged(self, subject: str, layer: Layer[None]) -> None:
        try:
            await run_layer(self._services, layer)
        except (HintedError, OSError, Fault) as error:
            what = shown(subject)
            _log.info("%s: cannot subscribe again: %s: %s", self._services.name, what, error)
