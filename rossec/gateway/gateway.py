"""Serves topics of other domains here: follows the graph of its master, a task for each topic.

A shell around `selection` and `topic`. A failure of one topic ends its task, not the others: it is
begun again after a pause. What the origin grants no longer is served no longer, at once; what the
graph shows no longer, as soon as no publisher of it is connected: masters that lose sight of each
other disturb no connection. The master may have ended the registrations of a gateway that did not
answer for a while, so they are made again when the graph lacks them.
"""

import asyncio
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from secrets import SystemRandom
from time import monotonic
from typing import Any, Final, NamedTuple

from ca.domains.aliases import origin_of, shown
from ca.domains.served import served_name
from grants.model import Right
from rossec import clock
from rossec.errors import ConfigurationError
from rossec.gateway.rules import TopicRule
from rossec.gateway.selection import BATCH, MAX_TOPICS, Candidate, Observed, chosen, observing
from rossec.gateway.topic import REFUSALS, ServedTopic
from rossec.net.aio.tasks import TaskSet
from rossec.net.rpc.client import RpcClient
from rossec.node import Node
from rossec.participant.graph_view import METHOD, GraphView
from rossec.participant.retry import Retry

PERIOD: Final = 1.0  # seconds between two looks at what has to be served
PAUSE: Final = 5.0  # seconds until a topic that failed, or a registration, is tried again
WATCH_DEADLINE: Final = 15.0  # seconds; an answer is held back for five
MAX_SKIPPED: Final = 100  # of those that the status names
MAX_LOGGED: Final = 5  # topics at a time
_log = logging.getLogger("rossec.gateway")


class Obstacle(NamedTuple):
    """Why a topic is not served, and what to do; the latter may be empty."""

    why: str
    hint: str = ""


@dataclass
class _Running:
    """A topic and the task that serves it."""

    topic: ServedTopic
    task: asyncio.Task[bool]


class Gateway:
    """Serves, as `node`, what the rules say.

    Attributes:
        skipped: why a topic that a rule covers is not served, by its alias.
        problem: why the graph of the master is not followed; empty: it is.
    """

    def __init__(self, node: Node, rules: Sequence[TopicRule], most: int = MAX_TOPICS) -> None:
        self.rules: Final = tuple(rules)
        self.skipped: dict[str, Obstacle] = {}
        self.problem = "the master has not answered yet"
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
        """What is served, by alias."""
        return {alias: each.topic for alias, each in self._running.items()}

    async def run(self) -> None:
        """Serve until cancelled."""
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
        """Begin and end topics as the graph and the rights say now."""
        for alias, each in tuple(self._running.items()):
            if each.task.done():
                self._forget(alias, each, now)
        self._again = {alias: each for alias, each in self._again.items() if now < each[0]}
        self._answered_at, self._observed = self._latest
        await self._judge()
        wanted = {each.alias: each for each in await self._wanted(now)}
        for alias, each in self._running.items():
            if alias not in wanted and (alias in self.skipped or not each.topic.sources):
                each.topic.stop()
        for alias in wanted.keys() - self._running.keys():
            self._begin(wanted[alias])
        await self._restore_lost(now)

    async def _wanted(self, now: float) -> list[Candidate]:
        """What to serve of the candidates; notes why the others are skipped."""
        able, skipped = list[Candidate](), dict[str, Obstacle]()
        for count, (alias, each) in enumerate(self._observed.candidates.items(), 1):
            obstacle = self._obstacle(each, now)
            if obstacle is not None:
                skipped[alias] = obstacle
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
        self._tell(before)
        return found

    def _tell(self, before: Mapping[str, Obstacle]) -> None:
        """Log what is new of the topics that are skipped."""
        new = [alias for alias, each in self.skipped.items() if before.get(alias) != each]
        for alias in new[:MAX_LOGGED]:
            why, hint = self.skipped[alias]
            _log.warning("%s is not served: %s%s", shown(alias), why, f" ({hint})" * bool(hint))
        if len(new) > MAX_LOGGED:
            _log.warning("and %d more: rossec gateway status", len(new) - MAX_LOGGED)

    def _obstacle(self, candidate: Candidate, now: float) -> Obstacle | None:
        """Why a topic cannot be served now; None: it can."""
        if missing := self._missing.get(candidate.alias):
            return missing
        others = self._observed.servers.get(candidate.served, frozenset()) - {self._node.name}
        if others and (candidate.alias not in self._running or min(others) < self._node.name):
            return Obstacle(f"{min(others)} serves it")
        at, why = self._again.get(candidate.alias, (now, ""))
        return Obstacle(why) if now < at else None

    async def _judge(self) -> None:
        """Find which topics there is a right for, if that may have changed."""
        known = self._observed, self._node.access.current(clock.now())
        if known == self._judged_for:
            return
        missing = dict[str, Obstacle | None]()
        for count, (alias, each) in enumerate(self._observed.candidates.items(), 1):
            missing[alias] = self._missing_right(each)
            if not count % BATCH:
                await asyncio.sleep(0)
        self._judged_for, self._missing = known, missing

    def _missing_right(self, candidate: Candidate) -> Obstacle | None:
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

    def _begin(self, candidate: Candidate) -> None:
        topic = ServedTopic(candidate, self._node.topics)
        task = self._tasks.spawn(_serve(topic), f"gateway: {candidate.alias}")
        task.add_done_callback(lambda _: self._changed.set())
        self._running[candidate.alias] = _Running(topic, task)

    def _forget(self, alias: str, ended: _Running, now: float) -> None:
        """A task has ended: by itself it is begun again at once, after a failure later."""
        del self._running[alias]
        self._again.pop(alias, None)
        crashed = ended.task.cancelled() or ended.task.exception() is not None
        if crashed or not ended.task.result():
            why = ended.topic.problem or "an error, which the log names"
            self._again[alias] = now + PAUSE, why

    async def _restore_lost(self, now: float) -> None:
        """Register everything again if an answer that should show a registration lacks it."""
        served = [each.topic for each in self._running.values()]
        lost = [
            each for each in served
            if each.registered_at is not None and each.registered_at + PAUSE < self._answered_at
            and self._node.name not in self._observed.servers.get(each.candidate.served, ())
        ]  # fmt: skip
        if not lost or now < self._restored_at + PAUSE:
            return
        self._restored_at = now
        _log.warning("%d topics are not registered any more: registered again", len(lost))
        try:
            await self._node.topics.restore()
        except REFUSALS as error:
            _log.info("not registered again: %s", error)

    # -- the graph

    async def _watch(self) -> None:
        """Follow the graph; what is known stays while the master is out of reach."""
        retry = Retry(SystemRandom().random)
        while True:
            try:
                await self._follow(retry)
            except REFUSALS as error:
                await asyncio.sleep(self._cannot_follow(error, retry))

    def _cannot_follow(self, error: BaseException, retry: Retry) -> float:
        """Say once why the graph is not known; returns after how many seconds to try again."""
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
                answer = await client.ask(METHOD, node.name, *self._view.next_params)
                if not self._view.take(answer).more:
                    await self._take_view(monotonic())
                    retry.succeeded()
                    await asyncio.sleep(PERIOD)  # each answer costs the master a look at every name
        finally:
            await client.close()

    async def _take_view(self, now: float) -> None:
        steps = observing(self._view.facts, self.rules)
        try:
            while True:
                next(steps)
                await asyncio.sleep(0)
        except StopIteration as end:
            self.problem, self._latest = "", (now, end.value)
        self._changed.set()


async def _serve(topic: ServedTopic) -> bool:
    """Serve a topic; returns whether it ended without an error."""
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
    """What `rossec gateway status` shows; `name`: of the gateway."""
    rows = [
        {
            "topic": shown(alias), "served": served_name(alias), "type": each.candidate.type,
            "state": "registering" if each.registered_at is None else each.phase.value,
            "subscribers": each.subscribers,
            "publishers": each.sources, "messages": each.messages, "octets": each.octets,
            "problem": each.problem,
        }
        for alias, each in sorted(gateway.topics.items())
    ]  # fmt: skip
    skipped = [
        {"topic": shown(alias), "why": each.why, "hint": each.hint}
        for alias, each in sorted(gateway.skipped.items())
    ]
    rules = [
        {"from": each.label, "pattern": each.pattern, "rate": each.wishes.rate,
         "newest": each.wishes.newest, "compress": each.wishes.deflate}
        for each in gateway.rules
    ]  # fmt: skip
    return {
        "gateway": name, "problem": gateway.problem, "rules": rules,
        "topics": rows, "skipped": skipped[:MAX_SKIPPED], "skipped_count": len(skipped),
    }  # fmt: skip
