"""What a gateway serves: rules, what of the graph they cover, the state of each topic. Pure.

A rule is a pattern of the origin's own names. Of several that cover a topic the first one counts. A topic
counts that has a publisher of its origin. An origin may show tens of thousands of topics, and
change them: what is done for each is done in steps, and messages pass between them.
"""

from collections.abc import Collection, Generator, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from ca import names
from ca.errors import HintedError, NameRefused
from grants.errors import DefinitionRefused
from rossec.errors import ConfigurationError, ConnectionHeaderRefused, RossecError
from rossec.node.subscriber import RawSource
from rossec.participant.definitions import Definition
from rossec.participant.delivery_options import DeliveryOptions
from rossec.participant.registrations import Fact
from rossec.ros.names import ANY_TYPE

MAX_RULES: Final = 256

MAX_TOPICS: Final = 1024
BATCH: Final = 512  # facts or topics in one step

LINGER: Final = 5.0  # seconds without a subscriber here until the origin is left
FIRST_PAUSE: Final = 1.0  # seconds after a failure, doubled with each further one
LONGEST_PAUSE: Final = 15.0


@dataclass(frozen=True)
class TopicRule:
    """The topics of the domain `label` that `pattern` covers, asked for with `options`."""

    label: str
    pattern: str
    options: DeliveryOptions = DeliveryOptions()  # noqa: RUF009 - has no state


def rule(label: str, pattern: str, options: DeliveryOptions) -> TopicRule:
    """The rule, checked: `pattern` is of the origin's own names, not of what it has from others."""
    try:
        names.check_label(label)
    except HintedError as error:
        raise ConfigurationError(str(error), "rossec domain list shows the labels") from error
    prefixes = (f"{label}:", f"/remote/{label}")
    named = next((each for each in prefixes if pattern.startswith(f"{each}/")), "")
    own = pattern.removeprefix(named)
    if own != pattern:
        raise ConfigurationError(
            f"{pattern[:255]!a} is a name here, not at its origin", f"--from {label} {own}"
        )
    try:
        names.check_pattern(pattern)
        names.alias_of(label, "/x")
    except HintedError as error:
        raise ConfigurationError(str(error), error.hint) from error
    if names.is_alias(pattern):
        raise ConfigurationError(
            f"{pattern} is what {label} calls other domains' topics: they travel one hop",
            "take the topic from its own domain: --from THAT-DOMAIN PATTERN",
        )
    return TopicRule(label, pattern, options)


def covering(rules: Sequence[TopicRule], alias: str) -> TopicRule | None:
    found = names.split_alias(alias)
    if found is None:
        return None
    label, name = found
    of_label = (each for each in rules if each.label == label)
    # Two domains whose gateways serve each other's `/**` would hand the same topics to and fro, under ever
    # longer names: what gateways serve is covered by patterns below `/gateway` alone.
    if names.is_in_gateway(name):
        of_label = (each for each in of_label if names.is_in_gateway(each.pattern))
    return next((each for each in of_label if names.pattern_covers(each.pattern, name)), None)


class SourceCandidate(NamedTuple):
    alias: str
    served: str
    rule: TopicRule
    type: str


class Observed(NamedTuple):
    candidates: Mapping[str, SourceCandidate]  # by alias
    servers: Mapping[str, frozenset[str]]  # the gateways that are registered, by served name


def observing(facts: Iterable[Fact], rules: Sequence[TopicRule]) -> Generator[None, None, Observed]:
    """What `facts`, which may not change meanwhile, say; yields between the steps."""
    types, published = dict[str, str](), set[str]()
    servers: dict[str, frozenset[str]] = {}
    for count, (kind, name, value) in enumerate(facts, 1):
        if kind == "type":
            types[name] = value
        elif kind == "publisher" and names.is_gateway(value):
            servers[name] = servers.get(name, frozenset()) | {value}
        elif kind == "publisher":
            with suppress(NameRefused):
                topic, node = names.split_alias(name), names.split_alias(value)
                if topic is not None and node is not None and topic[0] == node[0]:  # of its own origin
                    published.add(name)
        if not count % BATCH:
            yield
    candidates = dict[str, SourceCandidate]()
    for count, alias in enumerate(sorted(published), 1):
        rule = covering(rules, alias)
        if rule is not None:
            with suppress(NameRefused):  # it would be longer than a name
                kind = types.get(alias, ANY_TYPE)
                candidates[alias] = SourceCandidate(alias, names.served_name(alias), rule, kind)
        if not count % BATCH:
            yield
    return Observed(candidates, servers)


def chosen(
    candidates: Iterable[SourceCandidate], serving: Collection[str], most: int = MAX_TOPICS
) -> list[SourceCandidate]:
    """What there is room for, shared between the origins: one with many topics takes none from others.

    Within an origin what is served already comes first, so that a new topic replaces none.
    """
    by_label: dict[str, list[SourceCandidate]] = {}
    for each in candidates:
        by_label.setdefault(each.rule.label, []).append(each)
    taken, left = list[SourceCandidate](), most
    queues = sorted(by_label.values(), key=len)
    for number, queue in enumerate(queues):
        share = left // (len(queues) - number)
        queue.sort(key=lambda each: (each.alias not in serving, each.alias))
        taken += queue[:share]
        left -= min(share, len(queue))
    return taken


class TypeChanged(ConnectionHeaderRefused):
    pass


class TopicSources:
    def __init__(self) -> None:
        self.type: Definition | None = None
        self._connected: set[RawSource] = set()

    def __len__(self) -> int:
        return len(self._connected)

    @property
    def latching(self) -> bool:
        return len(self._connected) == 1 and next(iter(self._connected)).latching

    def connect(self, source: RawSource) -> bool:
        is_first = self.type is None
        if self.type is not None and not same_type(self.type, source.type):
            # While a publisher of the first type is connected, one of another type is refused, as every
            # subscriber in ROS refuses it. When none is, the type has changed: the topic has to begin again.
            told = f"{source.peer} publishes {source.type.name} ({source.type.md5sum})"
            kind = ConnectionHeaderRefused if self._connected else TypeChanged
            raise kind(f"{told}, and not {self.type.name} ({self.type.md5sum})")
        self.type = self.type or source.type
        self._connected.add(source)
        return is_first

    def disconnect(self, source: RawSource) -> None:
        self._connected.discard(source)


def same_type(one: Definition, other: Definition) -> bool:
    """Whether messages of both have the same bytes: the md5sum alone does not say it."""
    # A publisher states its md5sum, and may send another definition under it (forged-layout).
    if (one.name, one.md5sum) != (other.name, other.md5sum):
        return False
    return one.definition == other.definition or _digest(one) == _digest(other)


def _digest(kind: Definition) -> bytes | str:
    try:
        return kind.layout.digest
    except (DefinitionRefused, ConnectionHeaderRefused):
        return kind.definition


class GatewayPhase(Enum):
    IDLE = "idle"  # nobody is subscribed here
    SUBSCRIBED = "subscribed"
    LINGERING = "lingering"  # subscribed at the origin, and nobody here
    PAUSED = "paused"  # the master refused the subscription: tried again later


class GatewayEvent(Enum):
    WANTED = "somebody here is subscribed"
    UNWANTED = "nobody here is subscribed any more"
    DUE = "the time is over"
    FAILED = "the subscription failed"


class Action(Enum):
    NOTHING = "nothing"
    SUBSCRIBE = "subscribe at the origin"
    LEAVE = "end the subscription"


TABLE: Final = {
    (GatewayPhase.IDLE, GatewayEvent.WANTED): (GatewayPhase.SUBSCRIBED, Action.SUBSCRIBE),
    (GatewayPhase.SUBSCRIBED, GatewayEvent.UNWANTED): (GatewayPhase.LINGERING, Action.NOTHING),
    (GatewayPhase.SUBSCRIBED, GatewayEvent.FAILED): (GatewayPhase.PAUSED, Action.LEAVE),
    (GatewayPhase.LINGERING, GatewayEvent.WANTED): (GatewayPhase.SUBSCRIBED, Action.NOTHING),
    (GatewayPhase.LINGERING, GatewayEvent.DUE): (GatewayPhase.IDLE, Action.LEAVE),
    (GatewayPhase.LINGERING, GatewayEvent.FAILED): (GatewayPhase.IDLE, Action.LEAVE),
    (GatewayPhase.PAUSED, GatewayEvent.DUE): (GatewayPhase.SUBSCRIBED, Action.SUBSCRIBE),
    (GatewayPhase.PAUSED, GatewayEvent.UNWANTED): (GatewayPhase.IDLE, Action.NOTHING),
}
_WANTED_IN: Final = frozenset({GatewayPhase.SUBSCRIBED, GatewayPhase.PAUSED})


class TopicState:
    """Where one topic is in the table; times are of a monotonic clock."""

    # It is subscribed at its origin only while somebody here is, and a little longer: a program that is
    # started again, or one after the other, makes no new connection over the slow line each time.

    def __init__(self) -> None:
        self.phase = GatewayPhase.IDLE
        self.due: float | None = None  # when to call `step` at the latest; None: when something changes
        self._pause = FIRST_PAUSE

    def step(self, now: float, *, wanted: bool) -> Action:
        if wanted and self.phase not in _WANTED_IN:
            return self._enter(GatewayEvent.WANTED, now)
        if not wanted and self.phase in _WANTED_IN:
            return self._enter(GatewayEvent.UNWANTED, now)
        if self.due is not None and now >= self.due:
            return self._enter(GatewayEvent.DUE, now)
        return Action.NOTHING

    def failed(self, now: float) -> Action:
        action = self._enter(GatewayEvent.FAILED, now)
        self._pause = min(2 * self._pause, LONGEST_PAUSE)
        return action

    def connected(self) -> None:
        self._pause = FIRST_PAUSE

    def _enter(self, event: GatewayEvent, now: float) -> Action:
        if (self.phase, event) not in TABLE:
            raise RossecError(f"a topic that is {self.phase.value}, and then: {event.value}")
        self.phase, action = TABLE[self.phase, event]
        waits = {GatewayPhase.LINGERING: LINGER, GatewayPhase.PAUSED: self._pause}.get(self.phase)
        self.due = None if waits is None else now + waits
        return action


class Thinning:
    """Messages of one latching publisher, at most `rate` a second, and the last one all the same.

    The newest that is too early is held back, and due as soon as the rate admits it.
    """

    def __init__(self, rate: float) -> None:
        self._interval = 1 / rate
        self._next = float("-inf")
        self._held: bytes | None = None

    @property
    def due(self) -> float | None:
        return None if self._held is None else self._next

    def take(self, message: bytes, now: float) -> bytes | None:
        self._held = message
        return self.release(now)

    def release(self, now: float) -> bytes | None:
        if self._held is None or now < self._next:
            return None
        message, self._held, self._next = self._held, None, now + self._interval
        return message
