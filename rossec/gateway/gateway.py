"""Serves topics of other domains here: follows the graph of its master, a task for each topic.

A failure of one topic ends its task, not the others: it is begun again after a pause. What the origin
grants no longer is served no longer, at once; what the graph shows no longer, as soon as no publisher
of it is connected: masters that lose sight of each other disturb no connection.
"""

import asyncio
import contextlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from secrets import SystemRandom
from time import monotonic
from typing import Any, Final, NamedTuple, Protocol

from ca.errors import HintedError
from ca.names import is_alias, origin_of, served_name, shown
from grants.model import Right
from rossec import clock
from rossec.errors import ConfigurationError, ConnectionHeaderRefused, NodeShutdown
from rossec.gateway.rules import (
    BATCH,
    MAX_TOPICS,
    Action,
    Observed,
    SourceCandidate,
    Thinning,
    TopicRule,
    TopicSources,
    TopicState,
    TypeChanged,
    chosen,
    observing,
)
from rossec.host.runner import TaskSet
from rossec.net.rpc import RpcClient
from rossec.node import Node
from rossec.node.publisher import Publisher, RawPublisher
from rossec.node.subscriber import RawReceiver, RawSource
from rossec.participant.delivery_options import DeliveryOptions
from rossec.participant.registrations import WATCH_GRAPH, GraphView, Retry
from rossec.ros.xmlrpc import Fault

REFUSALS: Final = (HintedError, OSError, TimeoutError, Fault)
QUEUE_SIZE: Final = 10
_log = logging.getLogger("rossec.gateway")

PERIOD: Final = 1.0  # seconds between two looks at what has to be served
PAUSE: Final = 5.0  # seconds until a topic that failed, or a registration, is tried again
WATCH_DEADLINE: Final = 15.0  # seconds; an answer is held back for five
MAX_SKIPPED: Final = 100  # of those that the status names
MAX_LOGGED: Final = 5  # topics at a time


class GatewaySubscription(Protocol):
    async def close(self) -> None: ...


class RawTopics(Protocol):
    async def publish_raw(
        self, topic: str, type_name: str, on_demand: Any, *, queue_size: int
    ) -> RawPublisher: ...
    async def unpublish(self, publisher: Publisher) -> None: ...
    async def subscribe_raw(
        self, topic: str, receiver: RawReceiver, *, options: DeliveryOptions
    ) -> GatewaySubscription: ...


class ServedTopic:
    """Serves one topic until `stop`, or until its type changes: a publisher here, fed by its origin."""

    # However many are subscribed here, the origin has one subscriber. A refusal concerns this topic alone,
    # and ends its subscription at the origin; the publisher here stays, so that it serves again by itself.

    def __init__(self, candidate: SourceCandidate, topics: RawTopics) -> None:
        self.candidate: Final = candidate
        self.problem = ""  # why nothing comes
        self.messages = self.octets = 0  # that were forwarded
        self.registered_at: float | None = None  # by the monotonic clock
        self.state, self.sources, self._topics = TopicState(), TopicSources(), topics
        self._thinned: dict[RawSource, Thinning] = {}
        self._publisher: RawPublisher | None = None
        self._subscription: GatewaySubscription | None = None
        self._options = candidate.rule.options
        self._thins_here = self._subscribes_again = self._stopped = False
        self._wake = asyncio.Event()

    @property
    def subscribers(self) -> int:
        return 0 if self._publisher is None else len(self._publisher.links)

    def stop(self) -> None:
        self._stopped = True
        if self._publisher is not None:
            self._publisher.close()
            self._publisher.cut("no longer served")
        self._wake.set()

    async def run(self) -> None:
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
        now = monotonic()
        if self._subscribes_again:
            self._subscribes_again = False
            if self._subscription is not None:
                await self._leave()
                await self._subscribe()
        action = self.state.step(now, wanted=publisher.demand > 0)
        if action is Action.SUBSCRIBE:
            await self._subscribe()
        elif action is Action.LEAVE:
            await self._leave()
        else:
            for source, thinning in self._thinned.items():
                self._forward(publisher, source, thinning.release(now))
            dues = (self.state.due, *(each.due for each in self._thinned.values()))
            due = min((each for each in dues if each is not None), default=None)
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(None if due is None else max(0.0, due - now)):
                    await self._wake.wait()

    async def _subscribe(self) -> None:
        try:
            self._subscription = await self._topics.subscribe_raw(
                self.candidate.alias, self, options=self._options
            )
        except REFUSALS as error:
            self._note(error)
            self.state.failed(monotonic())
            await self._leave()

    async def _leave(self) -> None:
        subscription, self._subscription = self._subscription, None
        if subscription is not None:
            await subscription.close()

    def _forward(self, publisher: RawPublisher, source: RawSource, message: bytes | None) -> None:
        if message is None or self._stopped:
            return
        self.messages += 1
        self.octets += len(message)
        publisher.forward(source, message, keep=source.latching)

    def _note(self, error: Exception) -> None:
        reason = str(error) or type(error).__name__
        if reason != self.problem:
            _log.warning("%s: %s", shown(self.candidate.alias), reason)
        self.problem = reason
        if self._publisher is not None:
            self._publisher.problem = reason

    # -- of the subscription at the origin (RawReceiver)

    def connected(self, source: RawSource) -> None:
        publisher, rate = self._publisher, self.candidate.rule.options.rate
        if publisher is None or self._stopped:
            raise NodeShutdown(f"{shown(self.candidate.alias)} is served no longer")
        # Also an own node with every right is not taken for the origin (false-gateway).
        if not is_alias(source.peer):
            raise ConnectionHeaderRefused(f"{source.peer} is no node of the origin")
        if source.latching and rate is not None and not self._thins_here:
            # A sender that thins out drops what is too much, perhaps the very last: of a latched topic that
            # is its value (docs/decisions/0036). So it is thinned out here.
            self._thins_here = self._subscribes_again = True
            self._options = replace(self._options, rate=None, newest=True)
            self._wake.set()
            raise ConnectionHeaderRefused("the topic is latched: asked again, without a rate")
        try:
            is_first = self.sources.connect(source)
        except TypeChanged as error:
            self._note(error)
            self.stop()
            raise
        if self._thins_here and rate is not None:
            self._thinned[source] = Thinning(rate)
        if is_first:
            publisher.describe(source.type)
        publisher.latch = self.sources.latching
        self.problem = publisher.problem = ""
        self.state.connected()

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        if (publisher := self._publisher) is None:
            return
        thinning = self._thinned.get(source)
        for message in messages:
            now = message if thinning is None else thinning.take(message, monotonic())
            self._forward(publisher, source, now)
        if thinning is not None:
            self._wake.set()

    def disconnected(self, source: RawSource) -> None:
        self.sources.disconnect(source)
        self._thinned.pop(source, None)
        if self._publisher is not None:
            self._publisher.forget(source)
            self._publisher.latch = self.sources.latching

    def refused(self, error: Exception) -> None:
        # A publisher of the origin could not be connected, or is connected no longer.
        if not self._subscribes_again and not self._stopped:
            self._note(error)


class Obstacle(NamedTuple):
    why: str
    hint: str = ""


@dataclass
class _Running:
    topic: ServedTopic
    task: asyncio.Task[bool]


class Gateway:
    """What `rossec gateway` serves by its rules; of more than `most` topics each origin has a share."""

    def __init__(self, node: Node, rules: Sequence[TopicRule], most: int = MAX_TOPICS) -> None:
        self.rules: Final = tuple(rules)
        self.skipped: dict[str, Obstacle] = {}  # why what a rule covers is not served, by alias
        self.problem = "the master has not answered yet"  # empty: its graph is followed
        self._node = node
        self._most = most
        self._view = GraphView()
        self._observed = Observed({}, {})
        self._latest = float("-inf"), self._observed  # an answer's time, and what it shows
        self._running: dict[str, _Running] = {}
        self._tasks = TaskSet()
        self._again: dict[str, tuple[float, str]] = {}  # when, and why not now
        self._judged_for: object = None
        self._missing: dict[str, Obstacle | None] = {}  # a right, by alias
        self._answered_at = self._restored_at = float("-inf")
        self._changed = asyncio.Event()

    @property
    def topics(self) -> Mapping[str, ServedTopic]:
        return {alias: each.topic for alias, each in self._running.items()}

    async def run(self) -> None:
        watching = self._tasks.spawn(self._watch(), "gateway: the graph")
        try:
            while not watching.done():
                self._changed.clear()
                await self._look(monotonic())
                try:
                    async with asyncio.timeout(PERIOD):
                        await self._changed.wait()
                except TimeoutError:
                    continue
            watching.result()
        finally:
            for each in self._running.values():
                each.topic.stop()
            await self._tasks.close()

    # -- what has to be served

    async def _look(self, now: float) -> None:
        for alias, each in tuple(self._running.items()):
            if each.task.done():
                del self._running[alias]
                self._again.pop(alias, None)
                crashed = each.task.cancelled() or each.task.exception() is not None
                if crashed or not each.task.result():
                    why = each.topic.problem or "an error, which the log names"
                    self._again[alias] = now + PAUSE, why
        self._again = {alias: each for alias, each in self._again.items() if now < each[0]}
        self._answered_at, self._observed = self._latest
        await self._judge()
        wanted = {each.alias: each for each in await self._wanted(now)}
        for alias, each in self._running.items():
            if alias not in wanted and (alias in self.skipped or not each.topic.sources):
                each.topic.stop()
        for alias in wanted.keys() - self._running.keys():
            topic = ServedTopic(wanted[alias], self._node.topics)
            task = self._tasks.spawn(_serve(topic), f"gateway: {alias}")
            task.add_done_callback(lambda _: self._changed.set())
            self._running[alias] = _Running(topic, task)
        lost = [
            each.topic
            for each in self._running.values()
            if each.topic.registered_at is not None
            and each.topic.registered_at + PAUSE < self._answered_at
            and self._node.name not in self._observed.servers.get(each.topic.candidate.served, ())
        ]
        if lost and now >= self._restored_at + PAUSE:
            # The master may have ended the registrations of a gateway that did not answer for a while.
            self._restored_at = now
            _log.warning("%d topics are not registered any more: registered again", len(lost))
            try:
                await self._node.topics.restore()
            except REFUSALS as error:
                _log.info("not registered again: %s", error)

    async def _wanted(self, now: float) -> list[SourceCandidate]:
        able, skipped = list[SourceCandidate](), dict[str, Obstacle]()
        for count, (alias, each) in enumerate(self._observed.candidates.items(), 1):
            others = self._observed.servers.get(each.served, frozenset()) - {self._node.name}
            at, why = self._again.get(alias, (now, ""))
            if obstacle := self._missing.get(alias):
                skipped[alias] = obstacle
            elif others and (alias not in self._running or min(others) < self._node.name):
                # Of several gateways that serve it already the first by name goes on: both decide the same.
                skipped[alias] = Obstacle(f"{min(others)} serves it")
            elif now < at:
                skipped[alias] = Obstacle(why)
            else:
                able.append(each)
            if not count % BATCH:
                await asyncio.sleep(0)
        found = chosen(able, self._running.keys(), self._most)
        if len(found) < len(able):
            kept = {each.alias for each in found}
            over = [each.alias for each in able if each.alias not in kept]
            skipped |= dict.fromkeys(over, Obstacle(f"only {self._most} topics are served"))
        before, self.skipped = self.skipped, skipped
        new = [alias for alias, each in self.skipped.items() if before.get(alias) != each]
        for alias in new[:MAX_LOGGED]:
            why, hint = self.skipped[alias]
            _log.warning("%s is not served: %s%s", shown(alias), why, f" ({hint})" * bool(hint))
        if len(new) > MAX_LOGGED:
            _log.warning("and %d more: rossec gateway status", len(new) - MAX_LOGGED)
        return found

    async def _judge(self) -> None:
        known = self._observed, self._node.access.current(clock.now())
        if known == self._judged_for:
            return
        missing = dict[str, Obstacle | None]()
        for count, (alias, each) in enumerate(self._observed.candidates.items(), 1):
            missing[alias] = self._missing_right(each)
            if not count % BATCH:
                await asyncio.sleep(0)
        self._judged_for, self._missing = known, missing

    def _missing_right(self, candidate: SourceCandidate) -> Obstacle | None:
        access, now, name = self._node.access, clock.now(), self._node.name
        label, origin = candidate.rule.label, origin_of(candidate.alias)
        if not access.covers(Right.SUBSCRIBE, candidate.alias, now):
            return Obstacle(
                f"{label} has not granted {name} to subscribe it",
                f"there: rossec grant sign US:{name} --subscribe {origin} --out FILE;"
                " here: rossec grant install FILE",
            )
        if not access.covers(Right.PUBLISH, candidate.served, now):
            return Obstacle(
                f"{name} has no grant to publish {candidate.served}",
                f"rossec grant sign {name} --publish '/gateway/{label}/**'",
            )
        return None

    # -- the graph

    async def _watch(self) -> None:
        retry = Retry(SystemRandom().random)
        while True:
            try:
                await self._follow(retry)
            except REFUSALS as error:
                await asyncio.sleep(self._cannot_follow(error, retry))

    def _cannot_follow(self, error: BaseException, retry: Retry) -> float:
        # Says once why the graph is not known; returns after how many seconds to try again.
        why, pause = str(error) or type(error).__name__, retry.pause(monotonic())
        node = self._node
        if not node.access.covers(Right.GRAPH, node.access.master, clock.now()):
            why = f"{node.name} has no grant for it (rossec grant sign {node.name} --graph)"
            pause = PAUSE  # each attempt is a denial in the master's log
        if why != self.problem:
            _log.warning("the graph cannot be followed: %s", why)
        self.problem = why
        return pause

    async def _follow(self, retry: Retry) -> None:
        node = self._node
        stream = await node.dial_watch()
        if not node.access.is_master(stream.peer):
            stream.abort("not the master")
            raise ConfigurationError(f"{shown(stream.peer.name)} answers at the master's address")
        client = RpcClient(stream, deadline=WATCH_DEADLINE)
        try:
            while True:
                answer = await client.ask(WATCH_GRAPH, node.name, *self._view.next_params)
                if not self._view.take(answer).more:
                    now = monotonic()
                    steps = observing(self._view.facts, self.rules)
                    try:
                        while True:
                            next(steps)
                            await asyncio.sleep(0)
                    except StopIteration as end:
                        self.problem, self._latest = "", (now, end.value)
                    self._changed.set()
                    retry.succeeded()
                    await asyncio.sleep(PERIOD)  # each answer costs the master a look at every name
        finally:
            await client.close()


async def _serve(topic: ServedTopic) -> bool:
    try:
        await topic.run()
    except REFUSALS as error:
        topic.problem = str(error) or type(error).__name__
        _log.warning("%s is not served: %s", shown(topic.candidate.alias), topic.problem)
    except Exception as error:
        topic.problem = f"{type(error).__name__}: {error}"
        raise
    else:
        return True
    return False


def status(gateway: Gateway, name: str) -> dict[str, Any]:
    """What `rossec gateway status` shows, as JSON."""
    rows = [
        {
            "topic": shown(alias),
            "served": served_name(alias),
            "type": each.candidate.type,
            "state": "registering" if each.registered_at is None else each.state.phase.value,
            "subscribers": each.subscribers,
            "publishers": len(each.sources),
            "messages": each.messages,
            "octets": each.octets,
            "problem": each.problem,
        }
        for alias, each in sorted(gateway.topics.items())
    ]
    skipped = [
        {"topic": shown(alias), "why": each.why, "hint": each.hint}
        for alias, each in sorted(gateway.skipped.items())
    ]
    rules = [
        {
            "from": each.label,
            "pattern": each.pattern,
            "rate": each.options.rate,
            "newest": each.options.newest,
            "compress": each.options.deflate,
        }
        for each in gateway.rules
    ]
    return {
        "gateway": name,
        "problem": gateway.problem,
        "rules": rules,
        "topics": rows,
        "skipped": skipped[:MAX_SKIPPED],
        "skipped_count": len(skipped),
    }
