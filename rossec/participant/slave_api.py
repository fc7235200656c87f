"""The node's slave API: which calls it answers, and from whom.

Pure dispatch. Only the master's identity may control a node (attacks N1-N3). Any authenticated node
may call `requestTopic`, and the answer is the same whether the topic exists or not: the grant is
checked on the topic connection (N5). All other calls disclose information (N4): they are for the
master, and for peers that have presented a grant for them (`slave_rights`), as `rosnode ping`,
`info` and `kill` need; a relay of the own domain asks for the TCPROS port. UDPROS is never offered
(N10).
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Final, Protocol

from ca.certificates import Identity
from ca.domains.aliases import is_alias, shown
from ca.errors import HintedError
from rossec.participant.remote_names import answer_for
from rossec.participant.slave_rights import RELAY_ONLY, SLAVE_CALLS, is_relay
from rossec.ros.names import (
    DOMAINS_UPDATE,
    FOREIGN_UPDATE,
    MASTER,
    PORTS,
    REVOCATION_UPDATE,
)

Answer = list[object]
TCPROS: Final = "TCPROS"
DEADLINE: Final = 30.0  # seconds a connection of a peer that is not the master may last
_ERROR: Final = -1
ALIAS_ASKED: Final = (
    "a name below /remote is the caller's alias; a peer is asked by the origin's name"
)
NO_TRANSPORT: Final = (
    "rossec: only TCPROS, inside the secure channel; in C++: ros::TransportHints().reliable()"
)


class SlaveEvents(Protocol):
    """Handles the calls in the node."""

    def publishers_changed(self, topic: str, uris: list[str]) -> None:
        """The master's list of publishers of a topic this node subscribes to."""

    def parameter_changed(self, key: str, value: object) -> None:
        """A parameter at, above or below one this node subscribes to."""

    def revocations_arrived(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """The list and a fresh timestamp. Raises a `CAError` when either is refused."""

    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None:
        """A list of domains, or of foreign revocations; see `Membership.take_push`."""

    def shutdown_requested(self, reason: str) -> None:
        """The master shuts this node down, for example because another one has its name."""

    def topic_endpoint(self) -> tuple[str, int]:
        """Host and port where TCPROS connections are accepted."""

    def describe(self) -> Mapping[str, object]:
        """Values of the informational methods, by method name."""


@dataclass(frozen=True)
class SlaveMethod:
    """The rule of one method: the types of the parameters after caller_id, and who may call."""

    kinds: tuple[type, ...]
    default: object
    master_only: bool = True


RULES: Final[Mapping[str, SlaveMethod]] = {
    "publisherUpdate": SlaveMethod((str, list), 0),
    "paramUpdate": SlaveMethod((str, object), 0),
    "shutdown": SlaveMethod((str,), 0),
    REVOCATION_UPDATE: SlaveMethod((bytes, bytes), 0),
    DOMAINS_UPDATE: SlaveMethod((bytes,), 0),
    FOREIGN_UPDATE: SlaveMethod((str, bytes, bytes, list), 0),
    "requestTopic": SlaveMethod((str, list), [], master_only=False),
    PORTS: SlaveMethod((), [], master_only=False),
    "getName": SlaveMethod((), ""),
    "getUri": SlaveMethod((), ""),
    "getMasterUri": SlaveMethod((), ""),
    "getPid": SlaveMethod((), -1),
    "getBusStats": SlaveMethod((), []),
    "getBusInfo": SlaveMethod((), []),
    "getSubscriptions": SlaveMethod((), []),
    "getPublications": SlaveMethod((), []),
}


def refusal(
    method: str,
    params: tuple[object, ...],
    peer: Identity,
    *,
    authorized: bool = False,
    master: str = MASTER,
) -> Answer | None:
    """The error answer to a call that `peer` may not make; None: it may.

    `master`: the certified name of the node's own master.
    `authorized`: by grants (`check_slave_call`), which never allow the calls in `MASTER_ONLY`.
    """
    rule = RULES.get(method)
    if rule is None:
        return [_ERROR, "rossec: no such method", 0]
    only = _only_for(method, peer, master)
    if only is not None and not (authorized and method in SLAVE_CALLS):
        return [_ERROR, f"rossec: {method} is for {only} alone", rule.default]
    unnamed = without_caller(params, rule.default)
    if unnamed is not None:
        return unnamed
    if not _fits(params, rule.kinds):
        return [_ERROR, "Error: bad call arity or types", rule.default]
    if not peer.covers(str(params[0])):
        return [_ERROR, f"rossec: caller_id is not {shown(peer.name)}", rule.default]
    return alias_asked(method, params)


def _only_for(method: str, peer: Identity, master: str) -> str | None:
    """Who alone may call a method that `peer` may not; None: it may."""
    if method in RELAY_ONLY:
        return None if is_relay(peer) else "a relay"
    return "the master" if RULES[method].master_only and peer.name != master else None


def alias_asked(method: str, params: tuple[object, ...]) -> Answer | None:
    """The error answer to a request for a topic below `/remote`; None: it is none."""
    match method, params:
        case "requestTopic", (_, str() as topic, *_) if is_alias(topic):
            return [_ERROR, f"rossec: {ALIAS_ASKED}", []]
        case _:
            return None


def without_caller(params: tuple[object, ...], default: object) -> Answer | None:
    """Stock's answer to a call without a caller_id; None: it has one."""
    if not params:
        return [_ERROR, "missing required caller_id parameter", default]
    if not isinstance(params[0], str):
        return [_ERROR, "caller_id must be a string", default]
    return None


def topic_offer(protocols: list[object], host: str, port: int) -> Answer:
    """Answer of `requestTopic`, the same for every topic: TCPROS only."""
    if not offers_tcpros(protocols):
        return [_ERROR, NO_TRANSPORT, []]
    return [1, "ready", [TCPROS, host, port]]


def ports_answer(tcpros_port: int) -> Answer:
    """Answer to a relay's `rossec.ports`: at the host of the slave API."""
    return [1, "", [tcpros_port]]


def offers_tcpros(protocols: object) -> bool:
    """Whether the protocols that a subscriber offers include TCPROS."""
    named = protocols if isinstance(protocols, list) else []
    return any(isinstance(item, list) and item[:1] == [TCPROS] for item in named)


class SlaveApi:
    """Answers the calls of the slave API; `master` is the certified name of the own master."""

    def __init__(self, events: SlaveEvents, master: str = MASTER) -> None:
        self._events = events
        self._master = master
        self._methods: dict[str, Callable[..., Answer]] = {
            "publisherUpdate": self._publisher_update,
            "paramUpdate": self._param_update,
            "shutdown": self._shutdown,
            REVOCATION_UPDATE: self._revocation_update,
            DOMAINS_UPDATE: partial(self._push, DOMAINS_UPDATE),
            FOREIGN_UPDATE: partial(self._push, FOREIGN_UPDATE),
            "requestTopic": self._request_topic,
            PORTS: self._ports,
        }

    async def __call__(
        self, method: str, params: tuple[object, ...], peer: Identity, *, authorized: bool = False
    ) -> object:
        """Answer one call of the authenticated `peer`: always `[code, status, value]`."""
        refused = refusal(method, params, peer, authorized=authorized, master=self._master)
        if refused is not None:
            return refused
        run = self._methods.get(method, partial(self._describe, method))
        try:
            return run(peer, *params[1:])
        except HintedError as error:
            return [_ERROR, f"rossec: {error}", RULES[method].default]

    def _publisher_update(self, _: Identity, topic: str, uris: list[object]) -> Answer:
        self._events.publishers_changed(topic, [uri for uri in uris if isinstance(uri, str)])
        return [1, "", 0]

    def _param_update(self, _: Identity, key: str, value: object) -> Answer:
        self._events.parameter_changed(key, value)
        return [1, "", 0]

    def _shutdown(self, _: Identity, reason: str) -> Answer:
        self._events.shutdown_requested(reason)
        return [1, "shutdown", 0]

    def _revocation_update(self, master: Identity, revocations: bytes, timestamp: bytes) -> Answer:
        self._events.revocations_arrived(revocations, timestamp, master)
        return [1, "", 0]

    def _push(self, method: str, master: Identity, *params: object) -> Answer:
        self._events.push_arrived(method, params, master)
        return [1, "", 0]

    def _request_topic(self, _: Identity, _topic: str, protocols: list[object]) -> Answer:
        return topic_offer(protocols, *self._events.topic_endpoint())

    def _ports(self, _: Identity) -> Answer:
        return ports_answer(self._events.topic_endpoint()[1])

    def _describe(self, method: str, peer: Identity) -> Answer:
        return [1, "", answer_for(peer, method, self._events.describe()[method])]


def _fits(params: tuple[object, ...], kinds: tuple[type, ...]) -> bool:
    expected = (str, *kinds)
    return len(params) == len(expected) and all(map(isinstance, params, expected))
