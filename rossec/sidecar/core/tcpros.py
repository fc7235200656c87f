"""The TCPROS handshake between a program and a peer, both directions. Pure layers.

The header of one end is read once, authorized and sent to the other end, and its answer is
authorized in turn; grants are added towards the network and removed towards the program, names of
other origins are mapped (`remote_names`). A program
is asked for its topic port only for an authorized subscriber. The result says how to handle the
bytes that follow: a guard for restricted messages, otherwise none.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from ca.certificates import Identity
from ca.domains.aliases import is_alias, origin_of, split_alias
from grants.decision import Decision
from grants.guard import Guard
from grants.memory import MemoryScope
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.errors import ConnectionHeaderRefused, HangUp
from rossec.participant import service_handshake, topic_handshake
from rossec.participant.access import FIELD
from rossec.participant.definitions import (
    definition_fields,
    from_header,
    receiver_definition,
    reported_definition,
    sender_definition,
    size_of,
)
from rossec.participant.header_fields import Fields, text
from rossec.participant.remote_names import caller_here, fields_here, fields_on_wire
from rossec.participant.slave_api import TCPROS
from rossec.participant.topic_guard import FilterKey, guard_for
from rossec.participant.wire_names import granted_name
from rossec.participant.wishes import (
    NO_WISHES,
    Wishes,
    carried_out,
    check_carried_out,
    requested_wishes,
    taken_wishes,
    without_wishes,
)
from rossec.sidecar.core.commands import (
    AuthenticatePeer,
    CallProgram,
    ConnectPeer,
    ConnectProgram,
    Suspend,
)
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint
from rossec.sidecar.core.events import Answered, Event, HeaderArrived, NoAnswer
from rossec.sidecar.core.layers import AgentState, Layer, UnexpectedEvent, authenticated_peer
from rossec.sidecar.core.slave_calls import REQUEST_TOPIC, succeeded

_CALLER = "callerid"
_LONGEST_NAME = 255
FindMemoryScope: TypeAlias = Callable[[str], MemoryScope]  # by the program's caller_id


def unrestricted(decision: Decision) -> None:
    """No guard, where one cannot be: raises `RestrictionMismatch` for a restricted decision."""
    decision.require_unrestricted()


@dataclass(frozen=True)
class AdmittedConnection:
    """A connection whose two ends may exchange messages.

    Attributes:
        answer: the header for the end that asked.
        decision: the authorization of the peer; the connection ends with it.
        guard: filters each message before it is forwarded; None: bytes are forwarded unchanged.
        service: both directions carry data; else only from publisher to subscriber.
        message_size: of every message to a program, if the size is fixed and known.
        wishes: of a peer that subscribes.
        rebuild: makes the guard for another decision of the same peer, right and name.
    """

    answer: Mapping[str, bytes]
    decision: Decision
    guard: Guard | None
    service: bool
    message_size: int | None = None
    wishes: Wishes = NO_WISHES
    rebuild: Callable[[Decision], Guard | None] = unrestricted

    @property
    def latching(self) -> bool:
        """Whether the publisher sends its last message to new subscribers."""
        return self.answer.get("latching") == b"1"


def admit_peer(
    agent: AgentState,
    local: Endpoint,
    fields: Mapping[str, bytes],
    peer: Identity,
    filter_key: FilterKey,
    memory_scope_of: FindMemoryScope,
    now: int,
) -> Layer[AdmittedConnection]:
    """A peer subscribes to a topic of the program at `local`, or calls its service.

    Raises:
        ConnectionHeaderRefused, GrantError, CAError: the peer or the program is refused.
        HangUp: the program does not answer.
    """
    service, wishes = _is_service(fields), NO_WISHES
    if service is local.via_slave_api:
        raise ConnectionHeaderRefused(f"this port is not for {'services' if service else 'topics'}")
    if service:
        decision = service_handshake.admit_caller(fields, peer, agent.access, now)
        decision.require_unrestricted()
        target = local
    else:
        decision = topic_handshake.admit_subscriber(fields, peer, agent.access, now)
        wishes = carried_out(requested_wishes(fields), decision)
        target = yield from _request_topic(agent, local, fields, peer)
    event = yield ConnectProgram(target, fields_here(without_grants(fields), peer))
    if isinstance(event, NoAnswer) and event.dead:
        yield Suspend(local)
    arrived = _require_header(event)
    answer = _answer_for_peer(agent, fields, arrived.fields, peer)
    own = {**_own_proof(agent, fields, arrived.now), **wishes.fields}
    if service:
        return AdmittedConnection({**answer, **own}, decision, None, service)
    sent, program = from_header(answer), _program_name(arrived.fields)

    def guard_under(decision: Decision) -> Guard | None:
        check_carried_out(wishes, decision)
        if not decision.restrictions:
            return None
        kind = sender_definition(sent, decision, agent.known_types)
        return guard_for(kind, decision, filter_key, memory_scope_of(program))

    if decision.restrictions:
        kind = sender_definition(sent, decision, agent.known_types)
        answer |= {} if kind is sent else definition_fields(kind, decision)
    return AdmittedConnection(
        {**answer, **own}, decision, guard_under(decision), service,
        wishes=wishes, rebuild=guard_under,
    )  # fmt: skip


def _request_topic(
    agent: AgentState, local: Endpoint, fields: Mapping[str, bytes], peer: Identity
) -> Layer[Endpoint]:
    """The endpoint of the topic, requested from the program's slave API.

    Raises:
        ConnectionHeaderRefused: the program does not publish the topic.
        HangUp: the program does not answer.
    """
    topic = topic_handshake.requested_topic(fields)
    request = (caller_here(peer, text(fields, _CALLER)), topic, [[TCPROS]])
    event = yield CallProgram(local_endpoint(WireProtocol.HTTP, local.port), REQUEST_TOPIC, request)
    match event:
        case Answered(value=[code, _, [str(protocol), str(), int() as port]]) if (
            succeeded(code) and protocol == TCPROS and 0 < port < 1 << 16
        ):
            return local_endpoint(WireProtocol.TCPROS, port)
        case Answered():
            raise ConnectionHeaderRefused(f"{agent.identity.name} does not publish {topic}")
        case NoAnswer(dead=True, reason=reason):
            yield Suspend(local)
            raise HangUp(reason)
        case NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            raise UnexpectedEvent(type(event).__name__)


def _is_service(fields: Mapping[str, bytes]) -> bool:
    """Whether a header is for a service. One with both fields would be authorized as one and served
    as the other: roscpp and rospy check the topic first.

    Raises:
        ConnectionHeaderRefused: not exactly one of the two.
    """
    if ("service" in fields) is ("topic" in fields):
        raise ConnectionHeaderRefused("a connection header is for a topic or for a service")
    return "service" in fields


def _answer_for_peer(
    agent: AgentState, request: Mapping[str, bytes], answer: Mapping[str, bytes], peer: Identity
) -> dict[str, bytes]:
    """The program's answer under a certified name; rospy's publishers leave out the topic."""
    if "error" in answer:
        raise ConnectionHeaderRefused(text(answer, "error"))
    completed = {
        **without_grants(answer),
        _CALLER: _caller_name(agent, answer, peer.is_foreign),
    }
    if "topic" in request:
        completed["topic"] = request["topic"]
    return completed


def _program_name(fields: Mapping[str, bytes]) -> str:
    """The caller_id of a program."""
    return text(fields, _CALLER)[:_LONGEST_NAME] if _CALLER in fields else ""


def _caller_name(agent: AgentState, fields: Mapping[str, bytes], foreign: bool) -> bytes:
    """The callerid for a peer: a foreign one honours no certified tails."""
    given = text(fields, _CALLER) if _CALLER in fields and not foreign else ""
    return agent.name_for(given).encode()


def _own_proof(agent: AgentState, request: Mapping[str, bytes], now: int) -> Fields:
    if "service" in request:
        return service_handshake.provider_proof(text(request, "service"), agent.access, now)
    return {FIELD: agent.access.present(Right.PUBLISH, text(request, "topic"), now)}


def connect_to_peer(
    agent: AgentState,
    remote: Endpoint,
    fields: Mapping[str, bytes],
    filter_key: FilterKey,
    memory_scope_of: FindMemoryScope,
    now: int,
) -> Layer[AdmittedConnection]:
    """A program subscribes to a topic of the peer at `remote`, or calls its service.

    Raises:
        ConnectionHeaderRefused, GrantError, CAError: the peer refuses, or is not authorized to
        publish or provide. HangUp: the peer does not answer.
    """
    service = _is_service(fields)
    wanted = text(fields, "service" if service else "topic")
    if service:
        request = fields_on_wire(without_grants(fields))
        request[_CALLER] = _caller_name(agent, fields, is_alias(wanted))
        request |= service_handshake.caller_proof(wanted, agent.access, now)
        event = yield ConnectPeer(remote, request)
        arrived, peer = _from_peer(event)
        decision = service_handshake.admit_provider(
            arrived.fields, peer, wanted, agent.access, arrived.now
        )
        decision.require_unrestricted()
        answer = fields_here(without_grants(arrived.fields), peer)
        return AdmittedConnection(answer, decision, None, service)
    own, program = from_header(fields), _program_name(fields)
    granted, caller = yield from _name_granted(agent, remote, fields)
    request = {**without_grants(fields), _CALLER: caller, "topic": origin_of(granted).encode()}
    expected = topic_handshake.ExpectedTopic(granted, own.name, own.md5sum)
    request[FIELD] = agent.access.present(Right.SUBSCRIBE, granted, now)
    arrived, peer = _from_peer((yield ConnectPeer(remote, request)))
    decision = topic_handshake.admit_publisher(
        arrived.fields, peer, expected, agent.access, arrived.now
    )
    taken_wishes(arrived.fields, NO_WISHES)
    sent = from_header(arrived.fields)
    kind = receiver_definition(own, sent, decision, agent.known_types)

    def guard_under(decision: Decision) -> Guard | None:
        kind = receiver_definition(own, sent, decision, agent.known_types)
        if not decision.restrictions:
            return None
        return guard_for(kind, decision, filter_key, memory_scope_of(program))

    named = fields_here(without_grants(arrived.fields), peer, wanted)
    return AdmittedConnection(
        named | definition_fields(kind, decision), decision, guard_under(decision), service,
        size_of(reported_definition(kind, sent)), rebuild=guard_under,
    )  # fmt: skip


def _name_granted(
    agent: AgentState, remote: Endpoint, fields: Mapping[str, bytes]
) -> Layer[tuple[str, bytes]]:
    """The name whose grants count for the topic that is asked for, and the callerid for the peer.

    Of an alias both depend on who the peer is, which is known before it is sent anything.

    Raises:
        HangUp: the peer does not answer.
    """
    topic = text(fields, "topic")
    if not is_alias(topic):
        return topic, _caller_name(agent, fields, foreign=False)
    split_alias(topic)
    peer = authenticated_peer((yield AuthenticatePeer(remote)))
    return granted_name(peer, topic), _caller_name(agent, fields, peer.is_foreign)


def _from_peer(event: Event) -> tuple[HeaderArrived, Identity]:
    arrived = _require_header(event)
    if arrived.peer is None:
        raise UnexpectedEvent("a peer without an identity")
    return arrived, arrived.peer


def _require_header(event: Event) -> HeaderArrived:
    if isinstance(event, NoAnswer):
        raise HangUp(event.reason)
    if not isinstance(event, HeaderArrived):
        raise UnexpectedEvent(type(event).__name__)
    return event


def without_grants(fields: Mapping[str, bytes]) -> dict[str, bytes]:
    """The header without the fields of rossec: grants, and wishes."""
    return {key: value for key, value in without_wishes(fields).items() if key != FIELD}
