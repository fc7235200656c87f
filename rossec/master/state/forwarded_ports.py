"""Forwarded ports: local ports of relays that stand for masters, nodes and services of other sites. Pure.

Followers say what they want, relays poll for it, open forwarded ports and tell where they are. A forwarded
port is one of the own relay's, so nothing that another site says decides where it is. A relay that was
started again has no forwarded ports: it is told anew of all that is wanted. Of two relays that know a peer,
one serves it, and the other when that one falls silent. Of two with one name the newer one counts.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ca.bounded import Newest
from rossec.master.state.registry import Endpoint, endpoint
from rossec.ros.names import build_forwarded_port

MAX_FORWARDED_PORTS: Final = 4096  # as many as a relay has
MAX_RELAYS: Final = 64
MAX_PEERS: Final = 256  # of one relay
AT_ONCE: Final = 1024  # targets in one answer
SILENCE: Final = 12  # seconds; a relay polls every five
MASTER, NODE, SERVICE = "master", "node", "service"
KINDS: Final = (MASTER, NODE, SERVICE)

# Names and URIs of the masters of the own domain that are followed without a relay
Masters = Callable[[], Mapping[str, str]]


class Target(NamedTuple):
    """What a forwarded port stands for: a master, node or service at a peer, by its name there."""

    peer: str
    kind: str
    name: str


class ForwardedPort(NamedTuple):
    """Where a relay listens for a target."""

    host: str
    port: int

    @property
    def endpoint(self) -> Endpoint:
        return endpoint(build_forwarded_port(*self))


class PeerWay(NamedTuple):
    """How a relay reaches a peer: what it says of its links, for people."""

    state: str  # of its link; a relay dials when a forwarded port is used first
    rtt_ms: float  # round trip, milliseconds; 0: not known yet
    retransmissions: int  # since the link is there
    router: str  # which one is in use
    streams: int  # connections that the link carries


class RelayReport(NamedTuple):
    """A relay's call: its run, the version it has seen, forwarded ports opened since, and all its peers."""

    instance: str
    seen: int
    forwarded_ports: Mapping[Target, ForwardedPort]
    ways: Mapping[str, PeerWay]


class WantedChange(NamedTuple):
    version: int
    wanted: tuple[Target, ...]
    unwanted: tuple[Target, ...]


@dataclass
class _Relay:
    instance: str
    heard: int = 0
    ways: Mapping[str, PeerWay] = field(default_factory=dict)
    forwarded_ports: dict[Target, ForwardedPort] = field(default_factory=dict)
    places: dict[Endpoint, Target] = field(default_factory=dict)

    def put(self, target: Target, forwarded_port: ForwardedPort) -> bool:
        if self.forwarded_ports.get(target) == forwarded_port:
            return False
        before = self.places.get(forwarded_port.endpoint)
        for each in (target, before):
            if each is not None:
                self.drop(each)
        self.forwarded_ports[target], self.places[forwarded_port.endpoint] = forwarded_port, target
        return True

    def drop(self, target: Target) -> None:
        forwarded_port = self.forwarded_ports.pop(target, None)
        if forwarded_port is not None:
            self.places.pop(forwarded_port.endpoint, None)


class ForwardedPorts:
    """What is wanted of all relays, and what they have opened."""

    def __init__(self, limit: int = MAX_FORWARDED_PORTS) -> None:
        self.on_wanted: Callable[[], object] = lambda: None  # called when relays are to be told of something
        self.masters: Masters = dict  # those that relays shall poll too
        self._limit = limit
        self._version = 0
        self._wants: dict[str, set[Target]] = {}
        self._wanted: dict[Target, int] = {}  # since which version, the oldest first
        self._gone: Newest[Target, int] = Newest(limit)
        self._relays: dict[str, _Relay] = {}
        self._superseded: dict[str, str] = {}  # the run before that of now, by relay
        self._serving: dict[str, str] = {}  # which relay serves a peer
        self._listeners: dict[str, Callable[[], None]] = {}

    def listen(self, label: str, changed: Callable[[], None]) -> None:
        self._listeners[label] = changed

    def want(self, label: str, targets: Iterable[Target]) -> int:
        # All that the follower of a site wants from now on; returns how many are too many. Those are wanted
        # when it asks again and others are wanted no longer. The master of a site always has a forwarded
        # port; of others a site has at most as many as are left for all: none takes them from the next one,
        # whatever it says that it has.
        wanted, held, before = set(targets), self._wants.setdefault(label, set()), self._version
        for target in held - wanted:
            held.discard(target)
            self._release(target)
        missing, others = 0, sum(target.kind != MASTER for target in held)
        for target in sorted(wanted - held, key=lambda each: (each.kind != MASTER, each)):
            has_left = others < self._limit - len(self._wanted)
            if target in self._wanted or target.kind == MASTER or has_left:
                others += target.kind != MASTER
                held.add(target)
                if target not in self._wanted:
                    self._gone.pop(target, None)
                    self._wanted[target] = self._next_version()
            else:
                missing += 1
        if self._version != before:
            self.on_wanted()
        return missing

    def forget(self, label: str) -> None:
        self.want(label, ())
        self._wants.pop(label, None)
        self._listeners.pop(label, None)

    def forwarded_port(self, target: Target) -> ForwardedPort | None:
        relay = self._relays.get(self._serving.get(target.peer, ""))
        return None if relay is None else relay.forwarded_ports.get(target)

    def is_forwarded_port(self, place: Endpoint) -> bool:
        return any(place in relay.places for relay in self._relays.values())

    def way(self, peer: str) -> tuple[str, PeerWay] | None:
        name = self._serving.get(peer)
        return None if name is None else (name, self._relays[name].ways[peer])

    def has_room_for(self, relay: str) -> bool:
        return relay in self._relays or len(self._relays) < MAX_RELAYS

    def is_superseded(self, relay: str, instance: str) -> bool:
        """Whether a newer run of this relay has polled, so that this one must not."""
        return self._superseded.get(relay) == instance

    def hear(self, relay: str, report: RelayReport, now: int) -> WantedChange:
        held = self._relays.get(relay)
        if held is None or held.instance != report.instance:
            if held is not None:
                self._superseded[relay] = held.instance
            self._drop_relay(relay)
            held = self._relays[relay] = _Relay(report.instance)
        held.heard = now
        held.ways = dict(report.ways)
        changed = self._assign()
        for target, forwarded_port in report.forwarded_ports.items():
            if target in self._wanted and self._serving.get(target.peer) == relay:
                changed |= held.put(target, forwarded_port)
        if changed:
            self._notify()
        since = report.seen if report.seen <= self._version else 0  # it polled an earlier run of this master
        wanted = [
            (version, target)
            for target, version in self._wanted.items()
            if version > since and self._serving.get(target.peer) == relay
        ]
        gone = [(version, target) for target, version in self._gone.items() if version > since]
        told = sorted([*wanted, *gone])[:AT_ONCE]
        version = self._version if len(told) < AT_ONCE else told[-1][0]
        new = tuple(target for _, target in told if target in self._wanted)
        old = tuple(target for _, target in told if target in self._gone)
        return WantedChange(version, new, old)

    def expire(self, now: int) -> tuple[str, ...]:
        silent = [name for name, held in self._relays.items() if now - held.heard > SILENCE]
        for name in silent:
            self._superseded.pop(name, None)
            self._drop_relay(name)
        if silent:
            self._assign()
            self._notify()
        return tuple(silent)

    def _release(self, target: Target) -> None:
        if any(target in wants for wants in self._wants.values()):
            return
        del self._wanted[target]
        self._gone[target] = self._next_version()
        for relay in self._relays.values():
            relay.drop(target)

    def _assign(self) -> bool:
        before = dict(self._serving)
        for peer, name in before.items():
            if name not in self._relays or peer not in self._relays[name].ways:
                del self._serving[peer]
                for relay in self._relays.values():
                    for target in [each for each in relay.forwarded_ports if each.peer == peer]:
                        relay.drop(target)
        for name in sorted(self._relays):
            for peer in self._relays[name].ways:
                if peer not in self._serving:
                    self._serving[peer] = name
                    for target in [each for each in self._wanted if each.peer == peer]:
                        del self._wanted[target]
                        self._wanted[target] = self._next_version()
                    self.on_wanted()
        return self._serving != before

    def _drop_relay(self, name: str) -> None:
        self._relays.pop(name, None)
        for peer in [peer for peer, served_by in self._serving.items() if served_by == name]:
            del self._serving[peer]

    def _next_version(self) -> int:
        self._version += 1
        return self._version

    def _notify(self) -> None:
        for changed in tuple(self._listeners.values()):
            changed()
