"""Who wants to know when somebody comes, and asks the master who publishes instead of listening.

The program of `_watchers` registers when somebody comes and ends when they go. The watcher may
subscribe in slots alone, holds a registration, and is sent what the product sends; it has learned
on one day by how much it is told late, and is tried on another. Beside it: a grant without slots.
"""

from typing import Final

import numpy as np

from bench._watchers import NEAR, Span, day
from grants.decision import Reach
from grants.model import Permission, Restriction, Right
from rossec.master.rights.caller import Caller, CertifiedPeer
from rossec.master.rights.publisher_views import AliasPublishers
from rossec.master.state.graph import Graph
from rossec.master.state.imports import Imports
from rossec.master.state.registry import Kind, NodeRef, PublishersChanged, Registry

_TOPIC: Final = "/somebody"
_SOMEBODY: Final = NodeRef("/sensor", "http://10.0.0.2:1/", b"sensor")
_WATCHER: Final = NodeRef("/watcher", "http://10.0.0.3:1/", b"watcher")


def registered(slot: int, seconds: int) -> dict[str, dict[str, float]]:
    """The share of those who came that are known to have come within 5 s of a moment."""
    return {"in_slots": _scores(slot, seconds), "at_once": _scores(None, seconds)}


def _scores(slot: int | None, seconds: int) -> dict[str, float]:
    days = {seed: day(seed, seconds) for seed in (3, 4)}
    told = {seed: _told(spans, slot, seconds) for seed, spans in days.items()}
    starts = np.floor([start for start, _ in days[3]])
    late = [at - starts[starts <= at].max() for at in told[3]]
    guesses = np.array([at - float(np.median(late)) for at in told[4]])
    shares = {
        "naive": _share(np.array(told[4]), days[4]),
        "attacker": _share(guesses, days[4]),
        "prior": round(len(days[4]) * 2 * NEAR / seconds, 3),
    }
    return {**shares, "best": max(shares.values())}


def _told(spans: list[Span], slot: int | None, seconds: int) -> list[float]:
    """The seconds in which the watcher is sent that somebody publishes."""
    restriction = None if slot is None else Restriction(slot=slot)
    watcher = _caller(_WATCHER, Permission(_TOPIC, Right.SUBSCRIBE, restriction))
    sensor = _caller(_SOMEBODY, Permission(_TOPIC, Right.PUBLISH))
    registry = Registry()
    callers = {caller.name: caller for caller in (watcher, sensor)}

    def caller_of(peer: CertifiedPeer, _now: int) -> Caller | None:
        return callers.get(peer.name)

    aliases = AliasPublishers(Graph(registry, Imports(registry)), caller_of)
    registry.register_subscriber(_TOPIC, "*", _WATCHER)
    aliases.tell(watcher, _TOPIC, _WATCHER)
    comes = {int(start) for start, _ in spans}
    goes = {int(end) for _, end in spans}
    found: list[float] = []
    for now in range(seconds):
        updates = [each for changes in aliases.all_changes(now) for each in changes]
        events = registry.register_publisher(_TOPIC, "*", _SOMEBODY) if now in comes else []
        if now in goes:
            events += registry.unregister(Kind.PUBLISHER, _TOPIC, _SOMEBODY)[1]
        for event in events:
            if isinstance(event, PublishersChanged):
                updates += aliases.updates(event, now)
        found += [float(now) for each in updates if each.subscribers and each.publisher_uris]
    return found


def _caller(node: NodeRef, permission: Permission) -> Caller:
    return Caller(node.name, node.thumbprint, Reach([permission]), lambda _right, _name: None)


def _share(guesses: "np.ndarray[tuple[int], np.dtype[np.float64]]", spans: list[Span]) -> float:
    known = [np.abs(guesses - start).min() <= NEAR for start, _ in spans]
    return round(float(np.mean(known)), 3)
