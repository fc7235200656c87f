"""What following another master goes through, and what its answers mean. Pure.

Facts of a site that fell silent stay for a minute, marked: a master that restarts, or a link that comes back,
disturbs nobody. What the site refuses, and what was removed here, goes at once. Nothing here cuts a
connection between nodes: they judge each other without any master. An answer may come in parts, which are
taken over together; an empty one says that nothing has changed.
"""

from collections.abc import Callable, Iterable, Iterator
from enum import Enum
from itertools import accumulate
from typing import Any, Final, NamedTuple

from rossec.errors import AnswerMalformed, ImportRefused, RossecError
from rossec.federation.settings import SiteSettings
from rossec.master.state.forwarded_ports import NODE, SERVICE, ForwardedPort, Target
from rossec.master.state.imported_facts import FACTS_LIMIT, PROVIDER, checked, parts
from rossec.master.state.imported_facts import NODE as NODE_FACT
from rossec.master.state.imports import Imports
from rossec.participant.registrations import Fact, facts_of
from rossec.ros.names import build_forwarded_port, build_uri

SILENCE: Final = 12.0  # seconds without an answer; a poll is answered after at most 5
LOST_FOR: Final = 60.0  # seconds that facts stay without a connection
FIRST_PAUSE: Final = 1.0
LONGEST_PAUSE: Final = 30.0
_SPREAD: Final = 0.2  # or all masters of a site would return at the same moment


class SitePhase(Enum):
    IDLE = "idle"
    DIALLING = "dialling"
    GREETING = "greeting"
    FOLLOWING = "following"
    LISTENING = "listening"
    LOST = "lost"


class SiteEvent(Enum):
    DUE = "it is time to dial"
    CONNECTED = "there is a connection"
    ANSWERED = "the site has answered, and the answer is taken over"
    HIDDEN = "the site shows nothing of its graph, only what is revoked"
    FAILED = "no connection, no answer, or an invalid one"
    REFUSED = "the site is another one, or refuses"
    EXPIRED = "the facts of a lost site are too old"
    REMOVED = "it is followed no longer"


class SiteEffect(Enum):
    NONE = "nothing"
    MARK = "they are marked as lost"
    EXPIRE = "they go, and connections with the site's nodes stay"
    DROP = "they go, and subscribers here leave the site's publishers"


_CONNECTING: Final = (SitePhase.DIALLING, SitePhase.GREETING)
_OPEN: Final = (*_CONNECTING, SitePhase.FOLLOWING, SitePhase.LISTENING)
TABLE: Final = {
    (SitePhase.IDLE, SiteEvent.DUE): (SitePhase.DIALLING, SiteEffect.NONE),
    (SitePhase.LOST, SiteEvent.DUE): (SitePhase.DIALLING, SiteEffect.NONE),
    (SitePhase.FOLLOWING, SiteEvent.DUE): (SitePhase.DIALLING, SiteEffect.NONE),  # local nodes want more
    (SitePhase.DIALLING, SiteEvent.CONNECTED): (SitePhase.GREETING, SiteEffect.NONE),
    (SitePhase.GREETING, SiteEvent.ANSWERED): (SitePhase.FOLLOWING, SiteEffect.NONE),
    (SitePhase.FOLLOWING, SiteEvent.ANSWERED): (SitePhase.FOLLOWING, SiteEffect.NONE),
    (SitePhase.GREETING, SiteEvent.HIDDEN): (SitePhase.LISTENING, SiteEffect.DROP),
    (SitePhase.FOLLOWING, SiteEvent.HIDDEN): (SitePhase.LISTENING, SiteEffect.DROP),
    (SitePhase.LISTENING, SiteEvent.DUE): (SitePhase.DIALLING, SiteEffect.NONE),  # it may show more now
    **{(at, SiteEvent.FAILED): (SitePhase.LOST, SiteEffect.MARK) for at in _OPEN},
    **{(at, SiteEvent.REFUSED): (SitePhase.IDLE, SiteEffect.DROP) for at in _OPEN},
    **{(at, SiteEvent.EXPIRED): (at, SiteEffect.EXPIRE) for at in (*_CONNECTING, SitePhase.LOST)},
    **{(at, SiteEvent.REMOVED): (SitePhase.IDLE, SiteEffect.DROP) for at in SitePhase},
}


class SiteState:
    """Where one site is in the table, since when it is lost, and how long to wait."""

    def __init__(self) -> None:
        self.phase = SitePhase.IDLE
        # when the connection was lost, by a monotonic clock; None: it is followed, or its facts are gone
        self.lost_since: float | None = None
        self.failures = 0  # since it was followed
        self._has_facts = False

    def take(self, event: SiteEvent, clock: float) -> SiteEffect:
        found = TABLE.get((self.phase, event))
        if found is None:
            raise RossecError(f"a site that is {self.phase.value}, and: {event.value}")
        self.phase, effect = found
        if event in (SiteEvent.FAILED, SiteEvent.REFUSED):
            self.failures += 1
        if event is SiteEvent.ANSWERED:
            self.lost_since, self.failures, self._has_facts = None, 0, True
        elif effect in (SiteEffect.EXPIRE, SiteEffect.DROP):
            self.lost_since, self._has_facts = None, False
            self.failures = 0 if event is SiteEvent.HIDDEN else self.failures
        elif event is SiteEvent.FAILED and self._has_facts and self.lost_since is None:
            self.lost_since = clock
        return effect

    def has_expired(self, clock: float) -> bool:
        return self.lost_since is not None and clock - self.lost_since >= LOST_FOR

    def pause(self, rand: float, longest: float = LONGEST_PAUSE) -> float:
        pause = min(FIRST_PAUSE * 2.0 ** min(max(self.failures - 1, 0), 16), longest)
        return pause * (1 + _SPREAD * (2 * rand - 1))


NAMED: Final = 8 * 1024  # characters of all topics that are named; an answer is one line of a MiB


def site_status(settings: SiteSettings, state: SiteState, imports: Imports, clock: float) -> dict[str, Any]:
    # `topics` are those with publishers or subscribers there, by their names here.
    held = next((each for each in imports.sites if each.site.label == settings.label), None)
    topics = [] if held is None else held.topics()
    lost, ends = state.lost_since, accumulate(map(len, topics))
    return {
        "label": settings.label,
        "uri": settings.uri,
        "via": settings.via,
        "master": settings.master,
        "domain": settings.domain,
        "state": state.phase.value,
        "facts": 0 if held is None else held.facts,
        "lost_s": None if lost is None else round(clock - lost, 1),
        "parameters": list(settings.parameters),
        "topics": [topic for topic, end in zip(topics, ends, strict=True) if end <= NAMED],
        "topics_count": len(topics),
    }


METHOD: Final = "rossec.followSite"
MAX_PARTS: Final = 256  # until an answer is complete, also of those that `whole` made void
MAX_GATHERED: Final = 2 * FACTS_LIMIT  # facts in all of them: those added, and those removed
_DIGEST: Final = 32
_NONE: Final[frozenset[Fact]] = frozenset()
_HALF: Final = 1 << 30  # versions count modulo 2**31, the integers of XML-RPC


class SiteChange(NamedTuple):
    """A complete answer; facts have the site's own names."""

    added: frozenset[Fact]
    removed: frozenset[Fact]
    whole: bool  # `added` is all there is
    revocations: bytes  # revocations, domains: digests of the lists that the site holds; empty: none
    domains: bytes


class SiteCursor:
    """What to ask a site next."""

    def __init__(self) -> None:
        self._begin_again()

    def _begin_again(self) -> None:
        self.instance = ""  # of the run of the master that answered last; empty: none has
        self.version = -1  # of its graph then
        self._cursor = 0
        self._parts: list[SiteChange] = []
        self._taken = 0  # parts since the last complete answer
        self._gathered = 0  # facts in them
        self._lists = b"", b""  # the digests of the last answer

    def reconnected(self) -> None:
        self._taken = len(self._parts)
        self._gathered = sum(len(each.added) + len(each.removed) for each in self._parts)

    @property
    def params(self) -> tuple[str, int]:
        return self.instance, self._cursor

    def take(self, answer: object) -> SiteChange | None:
        if answer == {} and self.instance:
            return self._complete([*self._parts, SiteChange(_NONE, _NONE, False, *self._lists)])
        match answer:
            case {
                "instance": str() as instance,
                "version": int() as version,
                "cursor": int() as cursor,
                "whole": bool() as whole,
                "more": bool() as more,
                "added": list() as added,
                "removed": list() as removed,
                **lists,
            }:
                revocations = _digest(lists.get("revocations", b""))
                domains = _digest(lists.get("domains", b""))
            case _:
                raise AnswerMalformed("a site's answer that is malformed")
        part = SiteChange(facts_of(added), facts_of(removed), whole, revocations, domains)
        # Serial numbers (RFC 1982): less than half of the circle ahead is newer, the rest is older.
        if instance == self.instance and (version - self.version) % (2 * _HALF) >= _HALF:
            raise AnswerMalformed("a site's version runs backwards")
        self.instance, self.version, self._cursor = instance, version, cursor
        self._lists = revocations, domains
        if whole:
            self._parts.clear()
        self._parts.append(part)
        self._taken += 1
        self._gathered += len(part.added) + len(part.removed)
        if self._taken > MAX_PARTS or self._gathered > MAX_GATHERED:
            in_parts = self._taken > MAX_PARTS
            self._begin_again()
            raise AnswerMalformed(
                f"a site's answer in more than {MAX_PARTS} parts"
                if in_parts
                else f"a site's answer with more than {MAX_GATHERED} facts"
            )
        if more:
            return None
        return self._complete(self._parts)

    def _complete(self, parts: list[SiteChange]) -> SiteChange:
        self._parts, self._taken, self._gathered = [], 0, 0
        added, removed = set[Fact](), set[Fact]()
        for part in parts:  # in place: each part alone costs, not all before it again
            added |= part.added
            added -= part.removed
            removed |= part.removed
            removed -= part.added
        last, whole = parts[-1], parts[0].whole
        return SiteChange(frozenset(added), frozenset(removed), whole, last.revocations, last.domains)


def _digest(value: object) -> bytes:
    value = b"" if value == "" else value
    if not isinstance(value, bytes) or len(value) not in (0, _DIGEST):
        raise AnswerMalformed("a site's answer that is malformed")
    return value


_KINDS: Final = {NODE_FACT: NODE, PROVIDER: SERVICE}

FindForwardedPort = Callable[[Target], ForwardedPort | None]


class ForwardedPortFacts:
    """What one site says, as far as it concerns addresses; `peer`: the relay's label of the site."""

    # A node or service has no address here until its forwarded port is open, and another one when the relay
    # was started again; a forwarded port that is gone counts until there is another, or each restart of the
    # relay would take all publishers from their subscribers for a moment.
    def __init__(self, peer: str, find: FindForwardedPort) -> None:
        self._peer = peer
        self._find = find
        self._said: set[Fact] = set()
        self._forwarded_ports: dict[Target, ForwardedPort] = {}
        self._shown: set[Fact] = set()

    @property
    def targets(self) -> set[Target]:
        return {self._target(fact) for fact in self._said}

    def take(self, change: SiteChange) -> Iterator[None]:
        said = set[Fact]() if change.whole else self._said - change.removed
        for part in parts(change.added):
            said.update(fact for fact in checked(part) if fact[0] in _KINDS)
            yield
        if len(said) > FACTS_LIMIT:
            raise ImportRefused(f"more than {FACTS_LIMIT} addresses of {self._peer}")
        self._said = said

    def shown(self, change: SiteChange) -> SiteChange:
        self._look()
        forwarded_ports = set[Fact]()
        for fact in self._said:
            kind, name, _ = fact
            if (forwarded_port := self._forwarded_ports.get(self._target(fact))) is not None:
                service = build_uri(*forwarded_port, scheme="rosrpc").removesuffix("/")
                forwarded_ports.add(
                    (kind, name, build_forwarded_port(*forwarded_port) if kind == NODE_FACT else service)
                )
        added = _without_addresses(change.added) | (
            forwarded_ports if change.whole else forwarded_ports - self._shown
        )
        removed = _without_addresses(change.removed) | (self._shown - forwarded_ports)
        self._shown = forwarded_ports
        return change._replace(added=frozenset(added), removed=frozenset(removed))

    def forget(self) -> None:
        self._said, self._forwarded_ports, self._shown = set(), {}, set()

    def _look(self) -> None:
        # Find the forwarded ports of now; one that is gone is kept unless its place is another's.
        targets = self.targets
        found = {
            target: forwarded_port for target in targets if (forwarded_port := self._find(target)) is not None
        }
        taken = set(found.values())
        kept = self._forwarded_ports.items()
        old = {
            target: forwarded_port
            for target, forwarded_port in kept
            if target in targets and forwarded_port not in taken
        }
        self._forwarded_ports = {**old, **found}

    def _target(self, fact: Fact) -> Target:
        return Target(self._peer, _KINDS[fact[0]], fact[1])


def _without_addresses(facts: Iterable[Fact]) -> set[Fact]:
    return {fact for fact in facts if fact[0] not in _KINDS}
