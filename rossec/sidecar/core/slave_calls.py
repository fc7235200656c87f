"""Calls between nodes: a peer's to a program's slave API, and a program's to a peer's. Pure layers.

Both directions are default deny and drop UDPROS, which would bypass the channel (attack N10). A
peer is authorized before the program is called. `requestTopic` is answered here, with the same port
for every topic: the program is asked once an authorized peer connects to it (N5, `tcpros`). From a
peer behind a relay's door only that it offers TCPROS counts: the topic is at the door, too.
Answers are parsed and serialized again, and hold a value only if the code is 1: rospy takes any
positive code for success, and stock parsers accept what ours refuses; a program would connect in
plaintext to an address that the sidecar did not see. `getBusStats` is empty for peers: it would
count what a grant withholds. Only an older peer's is forwarded unparsed: roscpp's is malformed, and
it holds no address.
"""

from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import is_alias, split_alias
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.participant.remote_names import answer_for, answer_here, caller_here
from rossec.participant.slave_api import (
    NO_TRANSPORT,
    RULES,
    TCPROS,
    alias_asked,
    offers_tcpros,
    ports_answer,
    refusal,
    without_caller,
)
from rossec.participant.slave_rights import MASTER_ONLY, OPEN, SLAVE_CALLS, check_slave_call
from rossec.participant.wire_names import wire_name
from rossec.ros.names import PORTS, PRESENT_GRANTS
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Encoded, Fault
from rossec.sidecar.core.commands import AuthenticatePeer, CallPeer, CallProgram, Probe, Suspend
from rossec.sidecar.core.endpoints import Endpoint, parse_endpoint, topic_endpoint
from rossec.sidecar.core.events import Answered, Event, NoAnswer, RawResponse
from rossec.sidecar.core.layers import (
    AgentState,
    Layer,
    UnexpectedEvent,
    authenticated_peer,
    own_endpoint,
)

_UNPARSED: Final = frozenset({"getBusStats"})
REQUEST_TOPIC: Final = "requestTopic"
_INBOUND: Final = "i"
_MAX_EGRESS_PORTS: Final = 64  # ports that one answer of a peer can open


def handle_peer_call(
    agent: AgentState,
    local: Endpoint,
    peer: Identity,
    method: str,
    params: tuple[object, ...],
    grants: bytes | None,
    now: int,
) -> Layer[object]:
    """Answer a peer's call to the program at `local`.

    Raises:
        CallRefused, GrantError, CAError: the peer is not authorized.
        HangUp: the program does not answer.
    """
    node = agent.identity.name
    if method == PRESENT_GRANTS:
        agent.access.check_peer(peer, now)
        yield from _require_alive(agent, local, (yield Probe(local)))
        return [1, "", 0]
    check_slave_call(method, peer, node, grants, agent.access, now)
    answer = _answer_at_once(peer, method, params)
    if answer is not None:
        return answer
    if method in (REQUEST_TOPIC, PORTS):
        return (yield from _answer_with_port(agent, local, method))
    named = (caller_here(peer, str(params[0])), *params[1:])
    changed = yield from _params_for_program(agent, local, method, named)
    event = yield CallProgram(local, method, changed)
    yield from _require_alive(agent, local, event)
    match event:
        case Answered(value=[code, str() as status, value]) if succeeded(code):
            described = answer_for(peer, method, value)
            return (yield from _answer_for_peer(agent, local, method, status, described))
        case Answered(value=value):
            return _refusal(value)
        case _:
            raise UnexpectedEvent(method)


def _answer_at_once(peer: Identity, method: str, params: tuple[object, ...]) -> list[object] | None:
    """The answer that needs no program; None: it needs one."""
    if method == PORTS:
        return refusal(method, params, peer)
    refused = without_caller(params, RULES[method].default)
    if refused is None and method == REQUEST_TOPIC:
        return _invalid_request_topic(params) or alias_asked(method, params)
    if refused is None and method in _UNPARSED:
        return [1, "", answer_for(peer, method, None)]
    return refused


def _answer_with_port(agent: AgentState, local: Endpoint, method: str) -> Layer[object]:
    """Where its topics are, the same for every topic; a dead program does not answer."""
    yield from _require_alive(agent, local, (yield Probe(local)))
    ingress = yield from agent.ingress_endpoint(topic_endpoint(local))
    if method == PORTS:
        return ports_answer(ingress.port)
    return [1, "ready", [TCPROS, ingress.host, ingress.port]]


def succeeded(code: object) -> bool:
    """Whether an answer holds a value: its code is 1."""
    return type(code) is int and code == 1  # not True, not 1.0


def _refusal(answer: object) -> list[object]:
    """An unsuccessful or invalid answer, without its value."""
    match answer:
        case [(-1 | 0) as code, str() as status, _]:
            return [code, status, 0]
        case [_, str() as status, _]:
            return [-1, status, 0]
        case _:
            return [-1, "rossec: an answer that is not [code, status, value]", 0]


def _require_alive(agent: AgentState, local: Endpoint, event: Event) -> Layer[None]:
    """Hang up if the program did not answer; suspend its port if it has ended."""
    if isinstance(event, NoAnswer):
        if event.dead:
            agent.forget(local)
            yield Suspend(local)
        raise HangUp(event.reason)


def _params_for_program(
    agent: AgentState, local: Endpoint, method: str, params: tuple[object, ...]
) -> Layer[tuple[object, ...]]:
    if method == "publisherUpdate" and len(params) == 3:
        followed = agent.followed_publishers(params[1], params[2])
        return (*params[:2], (yield from agent.egress_uris(followed, local)))
    return params


def _invalid_request_topic(params: tuple[object, ...]) -> list[object] | None:
    """The refusal of a `requestTopic` without TCPROS or with invalid parameters; None: valid."""
    if len(params) != 3:
        return [-1, "Error: bad call arity", []]
    if not isinstance(params[1], str) or not params[1]:
        return [-1, "ERROR: parameter [topic] must be a non-empty string", []]
    return None if offers_tcpros(params[2]) else [-1, NO_TRANSPORT, []]


def _answer_for_peer(
    agent: AgentState, local: Endpoint, method: str, status: object, value: object
) -> Layer[object]:
    """A program's answer, rewritten for a peer: ingress ports in place of loopback ports."""
    match method, value:
        case "getUri", _:
            return [1, status, (yield from agent.ingress_endpoint(local)).uri]
        case "getMasterUri", _:
            return [1, status, ""]
        case "getBusInfo", list() as entries:
            return [1, status, (yield from _program_bus_info(agent, local, entries))]
        case _:
            return [1, status, value]


def _program_bus_info(
    agent: AgentState, local: Endpoint, entries: list[object]
) -> Layer[list[object]]:
    """A program's bus info; an incoming connection names its publisher, maybe the program."""
    rewritten: list[object] = []
    for entry in entries:
        match entry:
            case [number, str() as uri, "i", *rest]:
                endpoint = parse_endpoint(uri, WireProtocol.HTTP)
                remote = None if endpoint is None else agent.endpoints.peer_at(endpoint)
                if own_endpoint(uri) == local:
                    remote = yield from agent.ingress_endpoint(local)
                rewritten.append([number, uri if remote is None else remote.uri, _INBOUND, *rest])
            case _:
                rewritten.append(entry)
    return rewritten


def handle_program_call(
    agent: AgentState, remote: Endpoint, method: str, params: tuple[object, ...]
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
        refused = _invalid_request_topic(params)
    if refused is not None:
        return refused
    changed = (agent.identity.name, *params[1:])  # the peer may be foreign: without a tail
    if method == REQUEST_TOPIC:
        changed = yield from _request_for_peer(agent, remote, str(params[0]), str(params[1]))
    parse = method not in _UNPARSED
    event = yield CallPeer(remote, method, changed, SLAVE_CALLS.get(method), parse)
    match event:
        case RawResponse(body=body) if method in _UNPARSED:
            return Encoded(body)
        case Answered(value=[code, str() as status, value], peer=peer) if succeeded(code):
            named = (
                value if peer is None else answer_here(peer, agent.identity.domain, method, value)
            )
            return (yield from _answer_for_program(agent, remote, method, status, named))
        case Answered(value=value):
            return _refusal(value)
        case NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise UnexpectedEvent(method)


def _request_for_peer(
    agent: AgentState, remote: Endpoint, caller: str, topic: str
) -> Layer[tuple[object, ...]]:
    """The parameters of a program's `requestTopic`: for an alias, who the peer is decides."""
    if not is_alias(topic):
        return agent.name_for(caller), topic, [[TCPROS]]
    split_alias(topic)
    peer = authenticated_peer((yield AuthenticatePeer(remote)))
    return agent.name_for_peer(caller, peer), wire_name(peer, topic), [[TCPROS]]


def _answer_for_program(
    agent: AgentState, remote: Endpoint, method: str, status: object, value: object
) -> Layer[object]:
    """A peer's answer, rewritten for a program: egress ports in place of addresses."""
    match method, value:
        case "requestTopic", ["TCPROS", str() as host, int() as port] if (
            host and 0 < port < 1 << 16
        ) and not _leads_back(agent, remote, _topics_of(remote, host, port)):
            topics = _topics_of(remote, host, port)
            uri = yield from agent.egress_uri(topics)
            agent.endpoints.set_api(topics, remote)
            egress = parse_endpoint(uri, WireProtocol.TCPROS)
            return [1, "ready", ["TCPROS", egress.host, egress.port]] if egress else [-1, "", []]
        case "requestTopic", _:
            return [-1, NO_TRANSPORT, []]
        case "getUri", _:
            return [1, status, (yield from agent.egress_uri(remote))]
        case "getMasterUri", _:
            return [1, status, agent.master_uri]
        case "getBusInfo", list() as entries:
            return [1, status, (yield from _peer_bus_info(agent, entries))]
        case _:
            return [1, status, value]


def _topics_of(remote: Endpoint, host: str, port: int) -> Endpoint:
    """Where the topics of the peer at `remote` are, which names this host and port."""
    if remote.door:
        return Endpoint(WireProtocol.TCPROS, remote.host, remote.port)
    return Endpoint(WireProtocol.TCPROS, host, port)


def _leads_back(agent: AgentState, remote: Endpoint, endpoint: Endpoint) -> bool:
    """Whether another node names an endpoint of this identity (reflection)."""
    program_at = agent.endpoints.program_at
    return program_at(endpoint) is not None and program_at(remote) is None


def _peer_bus_info(agent: AgentState, entries: list[object]) -> Layer[list[object]]:
    """A peer's bus info, with the URIs that `lookupNode` returns: tools compare them."""
    uris: dict[str, str] = {}
    rewritten: list[object] = []
    for entry in entries:
        match entry:
            case [number, str() as uri, "i", *rest]:
                remote = parse_endpoint(uri, WireProtocol.HTTP)
                if remote is not None and uri not in uris and len(uris) < _MAX_EGRESS_PORTS:
                    own_api = agent.endpoints.program_at(remote)
                    uris[uri] = yield from agent.egress_uri(remote, own_api)
                rewritten.append([number, uris.get(uri, uri), _INBOUND, *rest])
            case _:
                rewritten.append(entry)
    return rewritten
