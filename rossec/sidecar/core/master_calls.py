"""Calls of programs to their master, rewritten for the secured one. Pure layers.

The table says where a call carries an address: the program's slave API, its service, or one in the
answer. A method that is not in it is not forwarded. Elements of a multicall are handled as single
calls. Registrations are stored, to be made again later (`registrations`).
"""

from dataclasses import dataclass
from enum import Enum
from typing import Final

from grants.basics import is_dispensable
from grants.missing_rights import missing_right
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.participant.caller_names import (
    RELATIVE_NAME,
    SEARCH,
    not_found,
    resolve_params,
    search_places,
    search_result,
    searched_key,
)
from rossec.participant.registrations import REGISTERS, UNREGISTERS
from rossec.participant.remote_names import offer_refusal
from rossec.participant.slave_api import without_caller
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.core.commands import CallMaster
from rossec.sidecar.core.endpoints import Endpoint, local_endpoint, parse_endpoint
from rossec.sidecar.core.events import Answered, NoAnswer
from rossec.sidecar.core.layers import AgentState, Layer, Program, UnexpectedEvent, own_endpoint

MULTICALL: Final = "system.multicall"
MULTICALL_LIMIT: Final = 4096


class Result(Enum):
    """The value of a successful answer."""

    PLAIN = "no address"
    NODES = "a list of slave API URIs"
    NODE = "a slave API URI"
    SERVICE = "a service URI, in the status text too"
    MASTER = "the master's own URI"


@dataclass(frozen=True)
class CallRule:
    """Where one method carries addresses; indices count the caller_id as 0.

    Attributes:
        api: the caller's slave API URI.
        service: a service URI of the caller.
        default: the value of a refusal, as of the stock master.
    """

    api: int | None = None
    service: int | None = None
    result: Result = Result.PLAIN
    default: object = 0


SUBSCRIBE: Final = "registerSubscriber"
REFUSED: Final = "rossec: "  # a status that begins so is not one of the stock master
_DISPENSABLE: Final = {"registerPublisher": [], "registerService": 1}
"""Registrations that succeed for a program that works without them, with their value."""
RULES: Final = {
    "registerPublisher": CallRule(api=3, result=Result.NODES, default=[]),
    SUBSCRIBE: CallRule(api=3, result=Result.NODES, default=[]),
    "registerService": CallRule(api=3, service=2),
    "subscribeParam": CallRule(api=1),
    "unregisterPublisher": CallRule(api=2),
    "unregisterSubscriber": CallRule(api=2),
    "unregisterService": CallRule(service=2),
    "unsubscribeParam": CallRule(api=1),
    "lookupNode": CallRule(result=Result.NODE, default=""),
    "lookupService": CallRule(result=Result.SERVICE, default=""),
    "getUri": CallRule(result=Result.MASTER, default=""),
    "getPid": CallRule(default=-1),
    "shutdown": CallRule(),
    "getSystemState": CallRule(default=[[], [], []]),
    "getTopicTypes": CallRule(default=[]),
    "getPublishedTopics": CallRule(),
    "getParam": CallRule(),
    "setParam": CallRule(),
    "deleteParam": CallRule(),
    "hasParam": CallRule(default=False),
    SEARCH: CallRule(),
    "getParamNames": CallRule(default=[]),
}


def handle_call(agent: AgentState, method: str, params: tuple[object, ...]) -> Layer[object]:
    """Answer one call of a program.

    Raises:
        Fault: no such method.
        HangUp: the master is unreachable; the program will try again.
    """
    if method == MULTICALL:
        return (yield from _multicall(agent, params))
    rule = rule_of(method)
    refused = _refusal(agent, method, rule, params)
    if refused is not None:
        return refused
    caller = str(params[0])
    master_params = yield from _params_for_master(agent, method, rule, caller, params)
    if master_params is None:
        return [-1, "rossec: this address is not the program's own", 0]
    key = None if master_params[0] == caller else searched_key(method, params)
    if key is None:
        answer = yield from _call_master(method, master_params)
    else:
        answer = yield from _search(caller, master_params[0], key)
    if answer[0] == 1:
        _record_registration(agent, method, rule, params, master_params)
        if method == SUBSCRIBE:
            answer[2] = agent.followed_publishers(master_params[RELATIVE_NAME[method]], answer[2])
        return (yield from _answer_for_program(agent, rule, _own_api(rule, params), answer))
    if method in REGISTERS and str(answer[1]).startswith(REFUSED):
        _record_registration(agent, method, rule, params, master_params, refused=True)
        missing = missing_right(str(answer[1]))
        if method in _DISPENSABLE and missing and is_dispensable(missing.right, missing.own):
            return [1, answer[1], _DISPENSABLE[method]]
    return answer


def _refusal(
    agent: AgentState, method: str, rule: CallRule, params: tuple[object, ...]
) -> list[object] | None:
    """The answer to a call that need not reach the master; None: it must."""
    refused = without_caller(params, rule.default)
    if refused is not None:
        return refused
    caller = str(params[0])
    if method in REGISTERS and not agent.covers(caller):
        return [-1, _not_covered(agent, caller), 0]
    return offer_refusal(method, resolve_params(method, params, caller))


def rule_of(method: str) -> CallRule:
    """The rule of a method.

    Raises:
        Fault: no such method.
    """
    rule = RULES.get(method)
    if rule is None:
        raise Fault(1, f"<class 'Exception'>:method \"{printable(method, 80)}\" is not supported")
    return rule


def _call_master(method: str, params: tuple[object, ...]) -> Layer[list[object]]:
    event = yield CallMaster(method, params)
    if not isinstance(event, Answered):
        raise HangUp(event.reason) if isinstance(event, NoAnswer) else UnexpectedEvent(method)
    answer = event.value
    if not isinstance(answer, list) or len(answer) != 3:
        raise HangUp("the master's answer is not [code, status, value]")
    return answer


def _search(caller: str, name: object, key: str) -> Layer[list[object]]:
    """Search from the namespace of `caller`; the master would search from that of `name`."""
    for candidate, found in search_places(caller, key):
        answer = search_result((yield from _call_master(SEARCH, (name, candidate))), found)
        if answer is not None:
            return answer
    return not_found(key)


def _multicall(agent: AgentState, params: tuple[object, ...]) -> Layer[object]:
    calls = params[0] if len(params) == 1 else None
    if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
        raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
    answers: list[object] = []
    for element in calls:
        try:
            answers.append([(yield from _element(agent, element))])
        except Fault as fault:
            answers.append({"faultCode": fault.faultCode, "faultString": fault.faultString})
    return answers


def _element(agent: AgentState, element: object) -> Layer[object]:
    match element:
        case {"methodName": str() as method, "params": list() as params} if method != MULTICALL:
            return (yield from handle_call(agent, method, tuple(params)))
        case _:
            raise Fault(1, "rossec: a multicall element needs methodName and params")


def _params_for_master(
    agent: AgentState, method: str, rule: CallRule, caller: str, params: tuple[object, ...]
) -> Layer[tuple[object, ...] | None]:
    """The parameters for the secured master; None: the address is not the program's own."""
    name = caller
    if method not in UNREGISTERS:  # `rosnode cleanup` names dead nodes; the master authorizes it
        name = agent.name_for(caller)
    changed = list(params if name == caller else resolve_params(method, params, caller))
    changed[0] = name
    for index, protocol in ((rule.api, WireProtocol.HTTP), (rule.service, WireProtocol.TCPROS)):
        if index is None or index >= len(params):
            continue
        given = parse_endpoint(params[index], protocol)
        if given is None:
            continue  # the master refuses it with a reason
        address = yield from _address(agent, method, given)
        if address is None:
            return None
        changed[index] = address
    own_api = _own_api(rule, params)
    if own_api is not None and method in REGISTERS:
        agent.endpoints.set_own_uri(own_api, str(params[rule.api or 0]))
        known = agent.programs.get(own_api)
        if known is None or known.name != caller:  # the port may have been reused
            agent.programs[own_api] = Program(caller)
    return tuple(changed)


def _address(agent: AgentState, method: str, given: Endpoint) -> Layer[str | None]:
    """The address, for the master, of an endpoint that a program names.

    An egress port stands for a peer: `rosnode cleanup` sends the URI that `lookupNode` returned. No
    program can register one as its own; the sidecar would call itself. Only who registers opens a
    port: who unregisters may name that of a program that has ended, which another one has now.
    """
    local = local_endpoint(given.protocol, given.port)
    remote = agent.endpoints.peer_at(local)
    if method not in REGISTERS:
        return (remote or agent.endpoints.network_of(local)).uri
    return None if remote is not None else (yield from agent.ingress_endpoint(local)).uri


def _own_api(rule: CallRule, params: tuple[object, ...]) -> Endpoint | None:
    if rule.api is None or rule.api >= len(params):
        return None
    return own_endpoint(params[rule.api])


def _record_registration(
    agent: AgentState,
    method: str,
    rule: CallRule,
    params: tuple[object, ...],
    master_params: tuple[object, ...],
    *,
    refused: bool = False,
) -> None:
    own_api = _own_api(rule, params)
    if method in REGISTERS and own_api is not None:
        program = agent.programs.setdefault(own_api, Program(str(params[0])))
        program.registrations.record(method, master_params, refused=refused)
    elif method in UNREGISTERS:
        for program in agent.programs.values():
            program.registrations.record(method, master_params)


def _answer_for_program(
    agent: AgentState, rule: CallRule, own_api: Endpoint | None, answer: list[object]
) -> Layer[list[object]]:
    """A successful answer of the master, rewritten for the program."""
    code, status, value = answer
    match rule.result:
        case Result.NODES:
            value = yield from agent.egress_uris(value, own_api)
        case Result.NODE:
            remote = parse_endpoint(value, WireProtocol.HTTP)
            value = "" if remote is None else (yield from _node(agent, remote))
        case Result.SERVICE:
            remote = parse_endpoint(value, WireProtocol.TCPROS)
            value = "" if remote is None else (yield from agent.egress_uri(remote))
            status = f"rosrpc URI: [{value}]"
        case Result.MASTER:
            value = agent.master_uri
        case Result.PLAIN:
            pass
    return [code, status, value]


def _node(agent: AgentState, remote: Endpoint) -> Layer[str]:
    """The URI of a node; a node of the same identity is reached directly."""
    own_api = agent.endpoints.program_at(remote)
    return (yield from agent.egress_uri(remote, own_api, probe=True))


def _not_covered(agent: AgentState, caller: str) -> str:
    name = agent.identity.name
    told = f"rossec: a program with the identity of {name} calls itself {printable(caller, 255)}:"
    if caller.startswith(f"{name}_"):  # as programs do that may run several times
        return (
            f"{told} start it with __name:={name.rpartition('/')[2]}, or enroll it for anonymous"
            f" nodes too, with a key of its own: rossec node request {name} --anonymous"
        )
    return f"{told} start it with __name:={name.rpartition('/')[2]}, or with an identity of its own"
