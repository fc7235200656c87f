"""One topic of another domain, served here: a publisher of its served name, fed by its origin.

A shell around `states`, `sources` and `thinning`. However many are subscribed here, the origin has
one subscriber. A refusal concerns this topic alone, and ends its subscription at the origin; the
publisher here stays, so that the topic serves again by itself.
"""

import asyncio
import contextlib
import logging
from collections.abc import Sequence
from dataclasses import replace
from time import monotonic
from typing import Any, Final, Protocol

from ca.domains.aliases import is_alias, shown
from ca.errors import HintedError
from rossec.errors import ConnectionHeaderRefused, NodeShutdown
from rossec.gateway.selection import Candidate
from rossec.gateway.sources import Sources, TypeChanged
from rossec.gateway.states import Action, Phase, TopicState
from rossec.gateway.thinning import Thinning
from rossec.node.publisher import Publisher
from rossec.node.raw_publisher import RawPublisher
from rossec.node.raw_subscriber import RawReceiver, RawSource
from rossec.participant.wishes import Wishes
from rossec.ros.xmlrpc import Fault

REFUSALS: Final = (HintedError, OSError, TimeoutError, Fault)
QUEUE_SIZE: Final = 10
_log = logging.getLogger("rossec.gateway")


class Subscription(Protocol):
    """What ends a subscription."""

    async def close(self) -> None:
        """End it."""


class RawTopics(Protocol):
    """The part of `rossec.node.topics.Topics` that is needed."""

    async def publish_raw(
        self, topic: str, type_name: str, on_demand: Any, *, queue_size: int
    ) -> RawPublisher:
        """See there."""

    async def unpublish(self, publisher: Publisher) -> None:
        """See there."""

    async def subscribe_raw(
        self, topic: str, receiver: RawReceiver, *, wishes: Wishes
    ) -> Subscription:
        """See there."""


class ServedTopic:
    """Serves one topic until `stop`, or until its type changes.

    Attributes:
        candidate: what it serves.
        problem: why nothing comes; empty: nothing is wrong.
        messages, octets: how much was forwarded.
        registered_at: since when it is registered, by the monotonic clock; None: it is not.
    """

    def __init__(self, candidate: Candidate, topics: RawTopics) -> None:
        self.candidate: Final = candidate
        self.problem = ""
        self.messages = 0
        self.octets = 0
        self.registered_at: float | None = None
        self._topics = topics
        self._state = TopicState()
        self._sources = Sources()
        self._thinned: dict[RawSource, Thinning] = {}
        self._publisher: RawPublisher | None = None
        self._subscription: Subscription | None = None
        self._wishes = candidate.rule.wishes
        self._thins_here = False
        self._subscribes_again = False
        self._stopped = False
        self._wake = asyncio.Event()

    @property
    def phase(self) -> Phase:
        """How far it is."""
        return self._state.phase

    @property
    def sources(self) -> int:
        """How many publishers of the origin are connected."""
        return len(self._sources)

    @property
    def subscribers(self) -> int:
        """How many are subscribed here."""
        return 0 if self._publisher is None else len(self._publisher.links)

    def stop(self) -> None:
        """End it: its subscribers are cut when `run` returns, and get nothing more before."""
        self._stopped = True
        if self._publisher is not None:
            self._publisher.close()
            self._publisher.cut("no longer served")
        self._wake.set()

    async def run(self) -> None:
        """Serve until it has to end.

        Raises:
            HintedError, OSError, TimeoutError, Fault: the master refuses the registration.
        """
        given = self.candidate
        publisher = await self._topics.publish_raw(
            given.served, given.type, self._wake.set, queue_size=QUEUE_SIZE
        )
        self._publisher, self.registered_at = publisher, monotonic()
        try:
            while not self._stopped:
                self._wake.clear()
                await self._follow(publisher)
        finally:
            await self._leave()
            await self._topics.unpublish(publisher)

    async def _follow(self, publisher: RawPublisher) -> None:
        """Do what is due, and wait until something may have changed."""
        now = monotonic()
        if self._subscribes_again:
            self._subscribes_again = False
            if self._subscription is not None:
                await self._leave()
                await self._subscribe()
        action = self._state.step(now, wanted=publisher.demand > 0)
        if action is Action.SUBSCRIBE:
            await self._subscribe()
        elif action is Action.LEAVE:
            await self._leave()
        else:
            self._release(publisher, now)
            await self._wait(now)

    async def _wait(self, now: float) -> None:
        dues = (self._state.due, *(each.due for each in self._thinned.values()))
        due = min((each for each in dues if each is not None), default=None)
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(None if due is None else max(0.0, due - now)):
                await self._wake.wait()

    async def _subscribe(self) -> None:
        try:
            self._subscription = await self._topics.subscribe_raw(
                self.candidate.alias, self, wishes=self._wishes
            )
        except REFUSALS as error:
            self._note(error)
            self._state.failed(monotonic())
            await self._leave()

    async def _leave(self) -> None:
        subscription, self._subscription = self._subscription, None
        if subscription is not None:
            await subscription.close()

    def _release(self, publisher: RawPublisher, now: float) -> None:
        """Forward what was held back and may go now."""
        for source, thinning in self._thinned.items():
            self._forward(publisher, source, thinning.release(now))

    def _forward(self, publisher: RawPublisher, source: RawSource, message: bytes | None) -> None:
        if message is None or self._stopped:
            return
        self.messages += 1
        self.octets += len(message)
        publisher.forward(source, message, keep=source.latching)

    def _note(self, error: Exception) -> None:
        """Say a reason once, and where somebody who waits in vain is told of it."""
        reason = str(error) or type(error).__name__
        if reason != self.problem:
            _log.warning("%s: %s", shown(self.candidate.alias), reason)
        self.problem = reason
        if self._publisher is not None:
            self._publisher.problem = reason

    # -- of the subscription at the origin (RawReceiver)

    def connected(self, source: RawSource) -> None:
        """A publisher of the origin is connected.

        Raises:
            ConnectionHeaderRefused: it is of another type, has to be asked in another way, or is a
                gateway itself: nothing is forwarded twice.
        """
        publisher, rate = self._publisher, self.candidate.rule.wishes.rate
        if publisher is None or self._stopped:
            raise NodeShutdown(f"{shown(self.candidate.alias)} is served no longer")
        if not is_alias(source.peer):
            raise ConnectionHeaderRefused(f"{source.peer} is no node of the origin")
        if source.latching and rate is not None and not self._thins_here:
            self._thins_here = self._subscribes_again = True
            self._wishes = replace(self._wishes, rate=None, newest=True)
            self._wake.set()
            raise ConnectionHeaderRefused("the topic is latched: asked again, without a rate")
        try:
            is_first = self._sources.connect(source)
        except TypeChanged as error:
            self._note(error)
            self.stop()
            raise
        if self._thins_here and rate is not None:
            self._thinned[source] = Thinning(rate)
        if is_first:
            publisher.describe(source.type)
        publisher.latch = self._sources.latching
        self.problem = publisher.problem = ""
        self._state.connected()

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        """Messages of a publisher."""
        if (publisher := self._publisher) is None:
            return
        thinning = self._thinned.get(source)
        for message in messages:
            now = message if thinning is None else thinning.take(message, monotonic())
            self._forward(publisher, source, now)
        if thinning is not None:
            self._wake.set()

    def disconnected(self, source: RawSource) -> None:
        """A publisher is gone, and what it latched with it."""
        self._sources.disconnect(source)
        self._thinned.pop(source, None)
        if self._publisher is not None:
            self._publisher.forget(source)
            self._publisher.latch = self._sources.latching

    def refused(self, error: Exception) -> None:
        """A publisher of the origin could not be connected, or is connected no longer."""
        if not self._subscribes_again and not self._stopped:
            self._note(error)
