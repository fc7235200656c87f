"""Calls between nodes: a peer's to a program's slave API, and a program's to a peer's. Pure layers.

Both directions are default deny and drop UDPROS, which would leave the channel (attack N10). A
peer is judged before the program hears of it. `requestTopic` is answered here, with the same door
for every topic: the program is asked when somebody with the right comes to it (N5, `headers`).
Answers are parsed and written anew, and hold a value only if the code is 1: rospy takes any
positive one for success, and stock parsers read what ours refuses, so that an address the sidecar
did not see would be dialled in clear. The one answer that travels as it is, is that of
`getBusStats`, where roscpp's is malformed; it holds no address.
"""

from typing import Final

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.participant.slave_api import NO_TRANSPORT, RULES, TCPROS, offers_tcpros, without_caller
from rossec.participant.slave_rights import (
    MASTER_ONLY,
    OPEN,
    PRESENT,
    SLAVE_CALLS,
    check_slave_call,
)
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Encoded, Fault
from rossec.sidecar.core.commands import AskLocal, AskRemote, Probe, Suspend
from rossec.sidecar.core.endpoints import Endpoint, endpoint, topics_of
from rossec.sidecar.core.events import Answered, Event, NoAnswer, Passed
from rossec.sidecar.core.layers import AgentState, Layer, UnexpectedEvent, own_endpoint

_UNPARSED: Final = frozenset({"getBusStats"})
REQUEST_TOPIC: Final = "requestTopic"
_INWARD: Final = "i"
_MOST_DOORS: Final = 64  # that one answer of a peer may have opened


def ask_program(
    tenant: AgentState,
    local: Endpoint,
    peer: Identity,
    method: str,
    params: tuple[object, ...],
    shown: bytes | None,
    now: int,
) -> Layer[object]:
    """Answer a peer's call to the program at `local`.

    Raises:
        CallRefused, GrantError, CAError: the peer may not.
        HangUp: the program does not answer.
    """
    node = tenant.identity.name
    if method == PRESENT:
        tenant.access.check_peer(peer, now)
        yield from _gone(tenant, local, (yield Probe(local)))
        return [1, "", 0]
    check_slave_call(method, peer, node, shown, tenant.access, now)
    unnamed = without_caller(params, RULES[method].default)
    if unnamed is not None:
        return unnamed
    if method == REQUEST_TOPIC:
        return (yield from _offer(tenant, local, params))
    changed = yield from _for_program(tenant, local, method, params)
    event = yield AskLocal(local, method, changed, parse=method not in _UNPARSED)
    yield from _gone(tenant, local, event)
    match event:
        case Passed(body=body) if method in _UNPARSED:
            return Encoded(body)
        case Answered(value=[code, str() as status, value]) if succeeded(code):
            return (yield from _program_says(tenant, local, method, status, value))
        case Answered(value=value):
            return _refusal(value)
        case _:
            raise UnexpectedEvent(method)


def _offer(tenant: AgentState, local: Endpoint, params: tuple[object, ...]) -> Layer[object]:
    """Where the topics of a program are, whatever the topic; a dead one is found out as ever."""
    refused = _no_topic(params)
    if refused is not None:
        return refused
    yield from _gone(tenant, local, (yield Probe(local)))
    door = yield from tenant.export(topics_of(local))
    return [1, "ready", [TCPROS, door.host, door.port]]


def succeeded(code: object) -> bool:
    """Whether an answer holds a value: its code is 1."""
    return type(code) is int and code == 1  # not True, not 1.0


def _refusal(answer: object) -> list[object]:
    """An answer that is none, or does not say success: without its value, whatever that is."""
    match answer:
        case [(-1 | 0) as code, str() as status, _]:
            return [code, status, 0]
        case [_, str() as status, _]:
            return [-1, status, 0]
        case _:
            return [-1, "rossec: an answer that is not [code, status, value]", 0]


def _gone(tenant: AgentState, local: Endpoint, event: Event) -> Layer[None]:
    """Refuse from now on in the name of a program that is gone."""
    if isinstance(event, NoAnswer):
        if event.dead:
            tenant.forget(local)
            yield Suspend(local)
        raise HangUp(event.reason)


def _for_program(
    tenant: AgentState, local: Endpoint, method: str, params: tuple[object, ...]
) -> Layer[tuple[object, ...]]:
    if method == "publisherUpdate" and len(params) == 3:
        followed = tenant.publishers_are(params[1], params[2])
        return (*params[:2], (yield from tenant.bring_all(followed, local)))
    return params


def _no_topic(params: tuple[object, ...]) -> list[object] | None:
    """What to answer to a `requestTopic` that cannot be one for TCPROS; None: it can."""
    if len(params) != 3:
        return [-1, "Error: bad call arity", []]
    if not isinstance(params[1], str) or not params[1]:
        return [-1, "ERROR: parameter [topic] must be a non-empty string", []]
    return None if offers_tcpros(params[2]) else [-1, NO_TRANSPORT, []]


def _program_says(
    tenant: AgentState, local: Endpoint, method: str, status: object, value: object
) -> Layer[object]:
    """The program's answer as a peer must see it: with doors in place of loopback ports."""
    match method, value:
        case "getUri", _:
            return [1, status, (yield from tenant.export(local)).uri]
        case "getMasterUri", _:
            return [1, status, ""]
        case "getBusInfo", list() as entries:
            return [1, status, (yield from _connections(tenant, local, entries))]
        case _:
            return [1, status, value]


def _connections(tenant: AgentState, local: Endpoint, entries: list[object]) -> Layer[list[object]]:
    """A program's connections; of incoming ones it names the URI of the publisher, maybe itself."""
    found: list[object] = []
    for entry in entries:
        match entry:
            case [number, str() as uri, "i", *rest]:
                place = endpoint(uri, WireProtocol.HTTP)
                remote = None if place is None else tenant.doors.peer_behind(place)
                if own_endpoint(uri) == local:
                    remote = yield from tenant.export(local)
                found.append([number, uri if remote is None else remote.uri, _INWARD, *rest])
            case _:
                found.append(entry)
    return found


def ask_peer(
    tenant: AgentState, remote: Endpoint, method: str, params: tuple[object, ...]
) -> Layer[object]:
    """Answer a program's call to the peer at `remote`.

    Raises:
        Fault: no such method.
        HangUp: the peer does not answer.
    """
    if method not in OPEN | MASTER_ONLY | SLAVE_CALLS.keys():
        raise Fault(1, f"<class 'Exception'>:method \"{printable(method, 80)}\" is not supported")
    refused = without_caller(params, RULES[method].default)
    if refused is None and method == REQUEST_TOPIC:
        refused = _no_topic(params)
    if refused is not None:
        return refused
    changed = (tenant.name_for(str(params[0])), *params[1:])
    if method == REQUEST_TOPIC:
        changed = (*changed[:2], [[TCPROS]])
    parse = method not in _UNPARSED
    event = yield AskRemote(remote, method, changed, SLAVE_CALLS.get(method), parse)
    match event:
        case Passed(body=body) if method in _UNPARSED:
            return Encoded(body)
        case Answered(value=[code, str() as status, value]) if succeeded(code):
            return (yield from _peer_says(tenant, remote, method, status, value))
        case Answered(value=value):
            return _refusal(value)
        case NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise UnexpectedEvent(method)


def _peer_says(
    tenant: AgentState, remote: Endpoint, method: str, status: object, value: object
) -> Layer[object]:
    """A peer's answer as the program must see it: with doors in place of addresses."""
    match method, value:
        case "requestTopic", ["TCPROS", str() as host, int() as port] if (
            host and 0 < port < 1 << 16
        ) and not _leads_back(tenant, remote, Endpoint(WireProtocol.TCPROS, host, port)):
            uri = yield from tenant.bring(Endpoint(WireProtocol.TCPROS, host, port))
            door = endpoint(uri, WireProtocol.TCPROS)
            return [1, "ready", ["TCPROS", door.host, door.port]] if door else [-1, "", []]
        case "requestTopic", _:
            return [-1, NO_TRANSPORT, []]
        case "getUri", _:
            return [1, status, (yield from tenant.bring(remote))]
        case "getMasterUri", _:
            return [1, status, tenant.master_uri]
        case "getBusInfo", list() as entries:
            return [1, status, (yield from _peers_connections(tenant, entries))]
        case _:
            return [1, status, value]


def _leads_back(tenant: AgentState, remote: Endpoint, place: Endpoint) -> bool:
    """Whether another node names a place of this identity's own: nobody may be led to itself."""
    behind = tenant.doors.program_behind
    return behind(place) is not None and behind(remote) is None


def _peers_connections(tenant: AgentState, entries: list[object]) -> Layer[list[object]]:
    """A peer's connections, with the URIs that `lookupNode` gives: tools compare the two."""
    doors: dict[str, str] = {}
    found: list[object] = []
    for entry in entries:
        match entry:
            case [number, str() as uri, "i", *rest]:
                remote = endpoint(uri, WireProtocol.HTTP)
                if remote is not None and uri not in doors and len(doors) < _MOST_DOORS:
                    own = tenant.doors.program_behind(remote)
                    doors[uri] = yield from tenant.bring(remote, own)
                found.append([number, doors.get(uri, uri), _INWARD, *rest])
            case _:
                found.append(entry)
    return found
