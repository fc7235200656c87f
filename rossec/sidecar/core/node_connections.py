"""Between nodes: calls of slave APIs and TCPROS handshakes, of peers and programs. Pure layers.

Both directions are default deny and drop UDPROS, which would bypass the channel (attack N10). A peer is
authorized before the program is called.

A header is read once, authorized and sent to the other end, and its answer is authorized in turn; grants are
added towards the network and removed towards the program, names of other origins are mapped.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeAlias, TypeGuard

from ca.certificates import Identity
from ca.names import is_alias, origin_of, split_alias
from grants.decision import Decision
from grants.guard import Guard, MemoryScope
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import ConnectionHeaderRefused, HangUp
from rossec.participant import definitions, delivery_options, handshakes, slave_api
from rossec.participant.access import FIELD, granted_name, wire_name
from rossec.peer_limits import printable
from rossec.ros import names, xmlrpc
from rossec.sidecar.core import layers

# Empty for peers: it would count what a grant withholds. A peer's is forwarded unparsed: roscpp's is
# malformed, and it holds no address.
_UNPARSED: Final = frozenset({"getBusStats"})
REQUEST_TOPIC: Final = "requestTopic"
_INBOUND: Final = "i"
_MAX_EGRESS_PORTS: Final = 64  # ports that one answer of a peer can open
_CALLER = "callerid"
_LONGEST_NAME = 255
FindMemoryScope: TypeAlias = Callable[[str], MemoryScope]  # by the program's caller_id


def handle_peer_call(
    agent: layers.AgentState,
    local: layers.ListeningAddress,
    peer: Identity,
    method: str,
    params: tuple[object, ...],
    grants: bytes | None,
    now: int,
) -> layers.Layer[object]:
    node = agent.identity.name
    if method == names.PRESENT_GRANTS:
        agent.access.check_peer(peer, now)
        yield from _require_alive(agent, local, (yield layers.Probe(local)))
        return [1, "", 0]
    slave_api.check_slave_call(method, peer, node, grants, agent.access, now)
    answer = _answer_at_once(peer, method, params)
    if answer is not None:
        return answer
    if method in (REQUEST_TOPIC, names.PORTS):
        # The same for every topic: the program is asked once an authorized peer connects there (N5).
        yield from _require_alive(agent, local, (yield layers.Probe(local)))
        ingress = yield from agent.ingress_endpoint(layers.topic_endpoint(local))
        if method == names.PORTS:
            return slave_api.ports_answer(ingress.port)
        return [1, "ready", [slave_api.TCPROS, ingress.host, ingress.port]]
    changed = (handshakes.caller_here(peer, str(params[0])), *params[1:])
    if method == "publisherUpdate" and len(params) == 3:
        followed = agent.followed_publishers(params[1], params[2])
        changed = (*changed[:2], (yield from agent.egress_uris(followed, local)))
    event = yield layers.CallProgram(local, method, changed)
    yield from _require_alive(agent, local, event)
    match event:
        case layers.Answered(value=[code, str() as status, value]) if succeeded(code):
            described = handshakes.answer_for(peer, method, value)
            return (yield from _answer_for_peer(agent, local, method, status, described))
        case layers.Answered(value=value):
            return _refusal(value)
        case _:
            raise layers.UnexpectedEvent(method)


def _answer_at_once(peer: Identity, method: str, params: tuple[object, ...]) -> list[object] | None:
    if method == names.PORTS:
        return slave_api.refusal(method, params, peer)
    refused = slave_api.without_caller(params, slave_api.RULES[method].default)
    if refused is None and method == REQUEST_TOPIC:
        return _invalid_request_topic(params) or slave_api.alias_asked(method, params)
    if refused is None and method in _UNPARSED:
        return [1, "", handshakes.answer_for(peer, method, None)]
    return refused


def succeeded(code: object) -> bool:
    # Answers are parsed and serialized again, and hold a value only if the code is 1: rospy takes any
    # positive code for success, and a program would connect in plaintext to an address that the sidecar did
    # not see.
    return type(code) is int and code == 1  # not True, not 1.0


def _refusal(answer: object) -> list[object]:
    match answer:
        case [(-1 | 0) as code, str() as status, _]:
            return [code, status, 0]
        case [_, str() as status, _]:
            return [-1, status, 0]
        case _:
            return [-1, "rossec: an answer that is not [code, status, value]", 0]


def _require_alive(
    agent: layers.AgentState, local: layers.ListeningAddress, event: layers.Event
) -> layers.Layer[None]:
    # Hang up if the program did not answer; suspend its port if it has ended.
    if isinstance(event, layers.NoAnswer):
        if event.dead:
            agent.forget(local)
            yield layers.Suspend(local)
        raise HangUp(event.reason)


def _invalid_request_topic(params: tuple[object, ...]) -> list[object] | None:
    if len(params) != 3:
        return [-1, "Error: bad call arity", []]
    if not isinstance(params[1], str) or not params[1]:
        return [-1, "ERROR: parameter [topic] must be a non-empty string", []]
    return None if slave_api.offers_tcpros(params[2]) else [-1, slave_api.NO_TRANSPORT, []]


def _answer_for_peer(
    agent: layers.AgentState, local: layers.ListeningAddress, method: str, status: object, value: object
) -> layers.Layer[object]:
    match method, value:
        case "getUri", _:
            return [1, status, (yield from agent.ingress_endpoint(local)).uri]
        case "getMasterUri", _:
            return [1, status, ""]
        case "getBusInfo", list() as entries:
            uris: dict[str, str] = {}
            for uri in _inbound(entries):
                endpoint = layers.parse_endpoint(uri, WireProtocol.HTTP)
                remote = None if endpoint is None else agent.endpoints.peer_at(endpoint)
                if layers.own_endpoint(uri) == local:
                    remote = yield from agent.ingress_endpoint(local)
                if remote is not None:
                    uris[uri] = remote.uri
            return [1, status, _with_uris(entries, uris)]
        case _:
            return [1, status, value]


def _inbound(entries: list[object]) -> list[str]:
    """The publishers in an answer to getBusInfo: only these are named by their URIs."""
    return [entry[1] for entry in entries if _is_inbound(entry)]


def _is_inbound(entry: object) -> TypeGuard[list[Any]]:
    return isinstance(entry, list) and len(entry) > 2 and isinstance(entry[1], str) and entry[2] == _INBOUND


def _with_uris(entries: list[object], uris: Mapping[str, str]) -> list[object]:
    return [
        [entry[0], uris.get(entry[1], entry[1]), *entry[2:]] if _is_inbound(entry) else entry
        for entry in entries
    ]


def handle_program_call(
    agent: layers.AgentState, remote: layers.ListeningAddress, method: str, params: tuple[object, ...]
) -> layers.Layer[object]:
    if method not in slave_api.OPEN | slave_api.MASTER_ONLY | slave_api.SLAVE_CALLS.keys():
        raise xmlrpc.Fault(1, f"<class 'Exception'>:method \"{printable(method, 80)}\" is not supported")
    refused = slave_api.without_caller(params, slave_api.RULES[method].default)
    if refused is None and method == REQUEST_TOPIC:
        refused = _invalid_request_topic(params)
    if refused is not None:
        return refused
    changed = (agent.identity.name, *params[1:])  # the peer may be foreign: no anonymous suffix
    if method == REQUEST_TOPIC:
        changed = yield from _request_for_peer(agent, remote, str(params[0]), str(params[1]))
    parse = method not in _UNPARSED
    event = yield layers.CallPeer(remote, method, changed, slave_api.SLAVE_CALLS.get(method), parse)
    match event:
        case layers.RawResponse(body=body) if method in _UNPARSED:
            return xmlrpc.Encoded(body)
        case layers.Answered(value=[code, str() as status, value], peer=peer) if succeeded(code):
            if peer is not None:
                value = handshakes.answer_here(peer, agent.identity.domain, method, value)
            return (yield from _answer_for_program(agent, remote, method, status, value))
        case layers.Answered(value=value):
            return _refusal(value)
        case layers.NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise layers.UnexpectedEvent(method)


def _request_for_peer(
    agent: layers.AgentState, remote: layers.ListeningAddress, caller: str, topic: str
) -> layers.Layer[tuple[object, ...]]:
    if not is_alias(topic):
        return agent.name_for(caller), topic, [[slave_api.TCPROS]]
    split_alias(topic)  # malformed: refused; who the peer is decides what the topic is called there
    peer = layers.authenticated_peer((yield layers.AuthenticatePeer(remote)))
    return agent.name_for_peer(caller, peer), wire_name(peer, topic), [[slave_api.TCPROS]]


def _answer_for_program(
    agent: layers.AgentState, remote: layers.ListeningAddress, method: str, status: object, value: object
) -> layers.Layer[object]:
    match method, value:
        case "requestTopic", ["TCPROS", str() as host, int() as port] if (host and 0 < port < 1 << 16) and (
            # Not back to a program here, unless it asked that one: the sidecar would connect to itself.
            agent.endpoints.program_at(_topics_of(remote, host, port)) is None
            or agent.endpoints.program_at(remote) is not None
        ):
            topics = _topics_of(remote, host, port)
            uri = yield from agent.egress_uri(topics)
            agent.endpoints.set_api(topics, remote)
            egress = layers.parse_endpoint(uri, WireProtocol.TCPROS)
            return [1, "ready", ["TCPROS", egress.host, egress.port]] if egress else [-1, "", []]
        case "requestTopic", _:
            return [-1, slave_api.NO_TRANSPORT, []]
        case "getUri", _:
            return [1, status, (yield from agent.egress_uri(remote))]
        case "getMasterUri", _:
            return [1, status, agent.master_uri]
        case "getBusInfo", list() as entries:
            uris: dict[str, str] = {}
            for uri in dict.fromkeys(_inbound(entries)):
                api = layers.parse_endpoint(uri, WireProtocol.HTTP)
                if api is not None and len(uris) < _MAX_EGRESS_PORTS:
                    uris[uri] = yield from agent.egress_uri(api, agent.endpoints.program_at(api))
            return [1, status, _with_uris(entries, uris)]
        case _:
            return [1, status, value]


def _topics_of(remote: layers.ListeningAddress, host: str, port: int) -> layers.ListeningAddress:
    # From a peer behind a relay's forwarded port only that it offers TCPROS counts: the topic is at the
    # forwarded port, too.
    if remote.forwarded_port:
        host, port = remote.host, remote.port
    return layers.ListeningAddress(WireProtocol.TCPROS, host, port)


def unrestricted(decision: Decision) -> None:
    # No guard, where one cannot be: raises `GrantError` for a restricted decision.
    decision.require_unrestricted()


@dataclass(frozen=True)
class AdmittedConnection:
    """A connection whose two ends may exchange messages."""

    answer: Mapping[str, bytes]  # the header for the end that asked
    decision: Decision  # of the peer; the connection ends with it
    guard: Guard | None  # filters each message before it is forwarded; None: bytes pass unchanged
    service: bool  # both directions carry data; else only from publisher to subscriber
    message_size: int | None = None  # of every message to a program, if it is fixed and known
    options: delivery_options.DeliveryOptions = delivery_options.NO_OPTIONS  # of a peer that subscribes
    rebuild: Callable[[Decision], Guard | None] = unrestricted  # for another decision of the same peer


def admit_peer(
    agent: layers.AgentState,
    local: layers.ListeningAddress,
    fields: Mapping[str, bytes],
    peer: Identity,
    filter_key: definitions.FilterKey,
    memory_scope_of: FindMemoryScope,
    now: int,
) -> layers.Layer[AdmittedConnection]:
    # 1. What is asked for, at the port for that; 2. the peer's right to it, before the program hears of it.
    service, options = _is_service(fields), delivery_options.NO_OPTIONS
    if service is local.via_slave_api:
        raise ConnectionHeaderRefused(f"this port is not for {'services' if service else 'topics'}")
    if service:
        decision = handshakes.admit_caller(fields, peer, agent.access, now)
        decision.require_unrestricted()  # calls pass unread here
        target = local
    else:
        decision = handshakes.admit_subscriber(fields, peer, agent.access, now)
        options = delivery_options.carried_out(delivery_options.requested_options(fields), decision)
        target = yield from _request_topic(agent, local, fields, peer)
    # 3. The program's own answer, without what only peers may see; 4. the proof of this side, and the guard.
    event = yield layers.ConnectProgram(target, handshakes.fields_here(without_grants(fields), peer))
    if isinstance(event, layers.NoAnswer) and event.dead:
        yield layers.Suspend(local)
    arrived = _require_header(event)
    if "error" in arrived.fields:
        raise ConnectionHeaderRefused(handshakes.text(arrived.fields, "error"))
    answer = without_grants(arrived.fields)
    answer[_CALLER] = _caller_name(agent, answer, peer.is_foreign)
    if service:
        own = handshakes.provider_proof(handshakes.text(fields, "service"), agent.access, arrived.now)
        return AdmittedConnection({**answer, **own}, decision, None, service)
    answer["topic"], topic = fields["topic"], handshakes.text(fields, "topic")
    own = {FIELD: agent.access.present(Right.PUBLISH, topic, arrived.now), **options.fields}
    sent, program = definitions.from_header(answer), _program_name(arrived.fields)

    def guard_under(decision: Decision) -> Guard | None:
        delivery_options.check_carried_out(options, decision)
        if not decision.restrictions:
            return None
        kind = definitions.sender_definition(sent, decision, agent.known_types)
        return definitions.guard_for(kind, decision, filter_key, memory_scope_of(program))

    if decision.restrictions:
        kind = definitions.sender_definition(sent, decision, agent.known_types)
        answer |= {} if kind is sent else definitions.definition_fields(kind, decision)
    return AdmittedConnection(
        {**answer, **own}, decision, guard_under(decision), service, options=options, rebuild=guard_under
    )


def _request_topic(
    agent: layers.AgentState, local: layers.ListeningAddress, fields: Mapping[str, bytes], peer: Identity
) -> layers.Layer[layers.ListeningAddress]:
    topic = handshakes.requested_topic(fields)
    request = (handshakes.caller_here(peer, handshakes.text(fields, _CALLER)), topic, [[slave_api.TCPROS]])
    event = yield layers.CallProgram(
        layers.local_endpoint(WireProtocol.HTTP, local.port), REQUEST_TOPIC, request
    )
    match event:
        case layers.Answered(value=[code, _, [str(protocol), str(), int() as port]]) if (
            succeeded(code) and protocol == slave_api.TCPROS and 0 < port < 1 << 16
        ):
            return layers.local_endpoint(WireProtocol.TCPROS, port)
        case layers.Answered():
            raise ConnectionHeaderRefused(f"{agent.identity.name} does not publish {topic}")
        case layers.NoAnswer(dead=True, reason=reason):
            yield layers.Suspend(local)
            raise HangUp(reason)
        case layers.NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise layers.UnexpectedEvent(type(event).__name__)


def _is_service(fields: Mapping[str, bytes]) -> bool:
    # Whether a header is for a service. One with both fields would be authorized as one and served as the
    # other: roscpp and rospy check the topic first.
    if ("service" in fields) is ("topic" in fields):
        raise ConnectionHeaderRefused("a connection header is for a topic or for a service")
    return "service" in fields


def _program_name(fields: Mapping[str, bytes]) -> str:
    return handshakes.text(fields, _CALLER)[:_LONGEST_NAME] if _CALLER in fields else ""


def _caller_name(agent: layers.AgentState, fields: Mapping[str, bytes], foreign: bool) -> bytes:
    given = handshakes.text(fields, _CALLER) if _CALLER in fields and not foreign else ""
    return agent.name_for(given).encode()


def connect_to_peer(
    agent: layers.AgentState,
    remote: layers.ListeningAddress,
    fields: Mapping[str, bytes],
    filter_key: definitions.FilterKey,
    memory_scope_of: FindMemoryScope,
    now: int,
) -> layers.Layer[AdmittedConnection]:
    service = _is_service(fields)
    wanted = handshakes.text(fields, "service" if service else "topic")
    if service:
        request = handshakes.fields_on_wire(without_grants(fields))
        request[_CALLER] = _caller_name(agent, fields, is_alias(wanted))
        request |= handshakes.caller_proof(wanted, agent.access, now)
        event = yield layers.ConnectPeer(remote, request)
        arrived, peer = _from_peer(event)
        decision = handshakes.admit_provider(arrived.fields, peer, wanted, agent.access, arrived.now)
        decision.require_unrestricted()
        answer = handshakes.fields_here(without_grants(arrived.fields), peer)
        return AdmittedConnection(answer, decision, None, service)
    # 1. Ask under the name that the grants have; 2. the publisher's right, before the program hears of it;
    # 3. its type, which the guard reads.
    own, program = definitions.from_header(fields), _program_name(fields)
    granted, caller = yield from _name_granted(agent, remote, fields)
    request = {**without_grants(fields), _CALLER: caller, "topic": origin_of(granted).encode()}
    request[FIELD] = agent.access.present(Right.SUBSCRIBE, granted, now)
    arrived, peer = _from_peer((yield layers.ConnectPeer(remote, request)))
    decision = handshakes.admit_publisher(arrived.fields, peer, granted, own, agent.access, arrived.now)
    delivery_options.accepted_options(arrived.fields, delivery_options.NO_OPTIONS)
    sent = definitions.from_header(arrived.fields)
    kind = definitions.receiver_definition(own, sent, decision, agent.known_types)

    def guard_under(decision: Decision) -> Guard | None:
        kind = definitions.receiver_definition(own, sent, decision, agent.known_types)
        if not decision.restrictions:
            return None
        return definitions.guard_for(kind, decision, filter_key, memory_scope_of(program))

    named = handshakes.fields_here(without_grants(arrived.fields), peer, wanted)
    return AdmittedConnection(
        named | definitions.definition_fields(kind, decision),
        decision,
        guard_under(decision),
        service,
        definitions.size_of(definitions.reported_definition(kind, sent)),
        rebuild=guard_under,
    )


def _name_granted(
    agent: layers.AgentState, remote: layers.ListeningAddress, fields: Mapping[str, bytes]
) -> layers.Layer[tuple[str, bytes]]:
    # Of an alias both depend on who the peer is, which is known before it is sent anything.
    topic = handshakes.text(fields, "topic")
    if not is_alias(topic):
        return topic, _caller_name(agent, fields, foreign=False)
    split_alias(topic)
    peer = layers.authenticated_peer((yield layers.AuthenticatePeer(remote)))
    return granted_name(peer, topic), _caller_name(agent, fields, peer.is_foreign)


def _from_peer(event: layers.Event) -> tuple[layers.HeaderArrived, Identity]:
    arrived = _require_header(event)
    if arrived.peer is None:
        raise layers.UnexpectedEvent("a peer without an identity")
    return arrived, arrived.peer


def _require_header(event: layers.Event) -> layers.HeaderArrived:
    if isinstance(event, layers.NoAnswer):
        raise HangUp(event.reason)
    if not isinstance(event, layers.HeaderArrived):
        raise layers.UnexpectedEvent(type(event).__name__)
    return event


def without_grants(fields: Mapping[str, bytes]) -> dict[str, bytes]:
    return {key: value for key, value in delivery_options.without_options(fields).items() if key != FIELD}
