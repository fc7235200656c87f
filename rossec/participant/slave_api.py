"""The node's slave API: which calls it answers, and from whom. Pure dispatch; every kind of node shares it.

Only the master controls a node (attacks N1-N3). An operator with the admin right may shut it down, one with
the graph right may read its state (N4), as `rosnode ping`, `info` and `kill` need; both present their grants
first, with `rossec.presentGrants`. Any authenticated node may call `requestTopic`: the answer is the same for
every topic, whether it exists or not, and the topic connection requires the grant (N5). A relay of the own
domain learns the TCPROS port, to which it leads connections from other sites. Every other method is refused
(L1); UDPROS is never offered (N10).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Protocol

from ca.certificates import Identity
from ca.errors import HintedError
from ca.names import is_alias, is_relay_name, shown
from grants.model import Right
from rossec.errors import RossecError
from rossec.participant.access import HandshakeAccess
from rossec.participant.handshakes import answer_for
from rossec.ros import names
from rossec.ros.names import MASTER

Answer = list[object]
TCPROS: Final = "TCPROS"
DEADLINE: Final = 30.0  # seconds a connection of a peer that is not the master may last
_ERROR: Final = -1
ALIAS_ASKED: Final = "a name below /remote is the caller's alias; a peer is asked by the origin's name"
NO_TRANSPORT: Final = (
    "rossec: only TCPROS, inside the secure channel; in C++: ros::TransportHints().reliable()"
)
OPEN: Final = frozenset({"requestTopic"})
MASTER_ONLY: Final = frozenset({"publisherUpdate", "paramUpdate"})
RELAY_ONLY: Final = frozenset({names.PORTS})
SLAVE_CALLS: Final[Mapping[str, Right]] = {
    "shutdown": Right.ADMIN,
    "getPid": Right.GRAPH,
    "getBusInfo": Right.GRAPH,
    "getBusStats": Right.GRAPH,
    "getSubscriptions": Right.GRAPH,
    "getPublications": Right.GRAPH,
    "getMasterUri": Right.GRAPH,
    "getName": Right.GRAPH,
    "getUri": Right.GRAPH,
}


def is_relay(peer: Identity) -> bool:
    return is_relay_name(peer.name) and not peer.is_foreign


def check_slave_call(
    method: str, peer: Identity, node: str, presented: bytes | None, access: HandshakeAccess, now: int
) -> None:
    """Return if `peer`, with the grants `presented`, may call `method` of the node `node`."""
    access.check_peer(peer, now)
    known = method in MASTER_ONLY or method in SLAVE_CALLS
    if method in OPEN or (known and access.is_master(peer)):
        return
    if method in RELAY_ONLY and is_relay(peer):
        return
    right = SLAVE_CALLS.get(method)
    if right is None:
        if method in MASTER_ONLY:
            raise RossecError(f"{method} is for the master alone")
        raise RossecError(f"{method} is for a relay alone" if method in RELAY_ONLY else "no such method")
    access.authorize(peer, presented, right, node, now)


class SlaveEvents(Protocol):
    def publishers_changed(self, topic: str, uris: list[str]) -> None: ...
    def parameter_changed(self, key: str, value: object) -> None: ...
    def push_arrived(self, method: str, params: tuple[object, ...], master: Identity) -> None: ...

    # The master shuts this node down, for example because another one has its name.
    def shutdown_requested(self, reason: str) -> None: ...
    def topic_endpoint(self) -> tuple[str, int]: ...
    def describe(self) -> Mapping[str, object]: ...


@dataclass(frozen=True)
class SlaveMethod:
    kinds: tuple[type, ...]
    default: object


RULES: Final[Mapping[str, SlaveMethod]] = {
    "publisherUpdate": SlaveMethod((str, list), 0),
    "paramUpdate": SlaveMethod((str, object), 0),
    "shutdown": SlaveMethod((str,), 0),
    names.REVOCATION_UPDATE: SlaveMethod((bytes, bytes), 0),
    names.DOMAINS_UPDATE: SlaveMethod((bytes,), 0),
    names.FOREIGN_UPDATE: SlaveMethod((str, bytes, bytes, list), 0),
    "requestTopic": SlaveMethod((str, list), []),
    names.PORTS: SlaveMethod((), []),
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
    method: str, params: tuple[object, ...], peer: Identity, *, authorized: bool = False, master: str = MASTER
) -> Answer | None:
    """The error answer to a call that `peer` may not make; None: it may.

    `master`: the certified name of the node's own master.
    `authorized`: by grants (`check_slave_call`), which never allow the calls in `MASTER_ONLY`.
    """
    rule = RULES.get(method)
    if rule is None:
        return [_ERROR, "rossec: no such method", 0]
    # 1. Who may call it, before any parameter is looked at (N1 to N4).
    if method in RELAY_ONLY:
        only = None if is_relay(peer) else "a relay"
    else:
        only = "the master" if method not in OPEN and peer.name != master else None
    if only is not None and not (authorized and method in SLAVE_CALLS):
        return [_ERROR, f"rossec: {method} is for {only} alone", rule.default]
    # 2. Number and types of the parameters, in stock's words where stock has some.
    unnamed = without_caller(params, rule.default)
    if unnamed is not None:
        return unnamed
    expected = (str, *rule.kinds)
    if len(params) != len(expected) or not all(map(isinstance, params, expected)):
        return [_ERROR, "Error: bad call arity or types", rule.default]
    # 3. The name that it gives itself, which logs and programs would believe.
    if not peer.covers(str(params[0])):
        return [_ERROR, f"rossec: caller_id is not {shown(peer.name)}", rule.default]
    return alias_asked(method, params)


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

    async def __call__(
        self, method: str, params: tuple[object, ...], peer: Identity, *, authorized: bool = False
    ) -> object:
        refused = refusal(method, params, peer, authorized=authorized, master=self._master)
        if refused is not None:
            return refused
        try:
            return self._run(method, params[1:], peer)
        except HintedError as error:
            return [_ERROR, f"rossec: {error}", RULES[method].default]

    def _run(self, method: str, params: tuple[Any, ...], peer: Identity) -> Answer:
        # What `RULES` says of the parameters was checked.
        events = self._events
        match method:
            case "publisherUpdate":
                topic, uris = params
                events.publishers_changed(topic, [uri for uri in uris if isinstance(uri, str)])
            case "paramUpdate":
                events.parameter_changed(*params)
            case "shutdown":
                events.shutdown_requested(*params)
                return [1, "shutdown", 0]
            case names.REVOCATION_UPDATE | names.DOMAINS_UPDATE | names.FOREIGN_UPDATE:
                events.push_arrived(method, params, peer)
            case "requestTopic":
                return topic_offer(params[1], *events.topic_endpoint())
            case names.PORTS:
                return ports_answer(events.topic_endpoint()[1])
            case _:
                return [1, "", answer_for(peer, method, events.describe()[method])]
        return [1, "", 0]
