"""Calls of programs to their master, rewritten for the secured one, and made again later. Pure layers.

The table says where a call carries an address: the program's slave API, its service, or one in the
answer. A method that is not in it is not forwarded. Elements of a multicall are handled as single
calls. Registrations are stored, to be made again: for a restarted master, for topics whose connection
ended, for rights that are new, and for publishers that the master did not name again in time.
"""

from collections.abc import Callable, Iterable
from enum import Enum
from typing import Final, NamedTuple, TypeAlias

from grants.model import Right
from grants.request import is_dispensable, missing_right
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.participant import handshakes, registrations, slave_api
from rossec.peer_limits import printable
from rossec.ros.names import MASTER
from rossec.ros.xmlrpc import Fault
from rossec.sidecar.core import layers

MULTICALL: Final = "system.multicall"
MULTICALL_LIMIT: Final = 4096
SUBSCRIBE: Final = "registerSubscriber"
# Registrations that succeed for a program that works without them, with their value.
_DISPENSABLE: Final = {"registerPublisher": [], "registerService": 1}
_RIGHTS: Final = {
    "registerPublisher": Right.PUBLISH,
    SUBSCRIBE: Right.SUBSCRIBE,
    "registerService": Right.PROVIDE,
}
Holds: TypeAlias = Callable[[Right, str], bool]
"""Whether this identity has a right on a name now; without it the master would only refuse."""

FIRST_DELAY: Final = 1.0
MAX_DELAY: Final = 32.0


class Result(Enum):
    PLAIN = "no address"
    NODES = "a list of slave API URIs"
    NODE = "a slave API URI"
    SERVICE = "a service URI, in the status text too"
    MASTER = "the master's own URI"


class CallRule(NamedTuple):
    """Where one method carries addresses; indices count the caller_id as 0."""

    api: int | None = None  # the caller's slave API URI
    service: int | None = None  # a service URI of the caller
    result: Result = Result.PLAIN
    default: object = 0  # the value of a refusal, as of the stock master


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
    registrations.SEARCH: CallRule(),
    "getParamNames": CallRule(default=[]),
}


def handle_call(agent: layers.AgentState, method: str, params: tuple[object, ...]) -> layers.Layer[object]:
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
    key = None if master_params[0] == caller else registrations.searched_key(method, params)
    if key is None:
        answer = yield from _call_master(method, master_params)
    else:
        answer = yield from _search(caller, master_params[0], key)
    if answer[0] == 1:
        _record_registration(agent, method, rule, params, master_params)
        if method == SUBSCRIBE:
            answer[2] = agent.followed_publishers(
                master_params[registrations.RELATIVE_NAME[method]], answer[2]
            )
        return (yield from _answer_for_program(agent, rule, _own_api(rule, params), answer))
    if method in registrations.REGISTERS and str(answer[1]).startswith(registrations.REFUSED):
        _record_registration(agent, method, rule, params, master_params, refused=True)
        missing = missing_right(str(answer[1]))
        if method in _DISPENSABLE and missing and is_dispensable(missing.right, missing.own):
            return [1, answer[1], _DISPENSABLE[method]]
    return answer


def _refusal(
    agent: layers.AgentState, method: str, rule: CallRule, params: tuple[object, ...]
) -> list[object] | None:
    # The answer to a call that need not reach the master; None: it must.
    refused = slave_api.without_caller(params, rule.default)
    if refused is not None:
        return refused
    caller = str(params[0])
    if method in registrations.REGISTERS and not agent.covers(caller):
        name = agent.identity.name
        told = (
            f"rossec: a program with the identity of {name} calls itself {printable(caller, 255)}:"
            f" start it with __name:={name.rpartition('/')[2]}, or"
        )
        if caller.startswith(f"{name}_"):  # as programs do that may run several times
            again = f"rossec node request {name} --anonymous"
            return [-1, f"{told} enroll it for anonymous nodes too, with a key of its own: {again}", 0]
        return [-1, f"{told} with an identity of its own", 0]
    return handshakes.offer_refusal(method, registrations.resolve_params(method, params, caller))


def rule_of(method: str) -> CallRule:
    rule = RULES.get(method)
    if rule is None:  # what is not in the table might carry an address that nobody rewrote
        raise Fault(1, f"<class 'Exception'>:method \"{printable(method, 80)}\" is not supported")
    return rule


def _call_master(method: str, params: tuple[object, ...]) -> layers.Layer[list[object]]:
    event = yield layers.CallMaster(method, params)
    if not isinstance(event, layers.Answered):
        raise HangUp(event.reason) if isinstance(event, layers.NoAnswer) else layers.UnexpectedEvent(method)
    answer = event.value
    if not isinstance(answer, list) or len(answer) != 3:
        raise HangUp("the master's answer is not [code, status, value]")
    return answer


def _search(caller: str, name: object, key: str) -> layers.Layer[list[object]]:
    # Search from the namespace of `caller`; the master would search from that of `name`.
    for candidate, found in registrations.search_places(caller, key):
        answer = registrations.search_result(
            (yield from _call_master(registrations.SEARCH, (name, candidate))), found
        )
        if answer is not None:
            return answer
    return registrations.not_found(key)


def _multicall(agent: layers.AgentState, given: tuple[object, ...]) -> layers.Layer[object]:
    calls = given[0] if len(given) == 1 else None
    if not isinstance(calls, list) or len(calls) > MULTICALL_LIMIT:
        raise Fault(1, f"rossec: a multicall is one list of at most {MULTICALL_LIMIT} calls")
    answers: list[object] = []
    for element in calls:
        try:
            match element:
                case {"methodName": str() as method, "params": list() as params} if method != MULTICALL:
                    answers.append([(yield from handle_call(agent, method, tuple(params)))])
                case _:
                    raise Fault(1, "rossec: a multicall element needs methodName and params")
        except Fault as fault:
            answers.append({"faultCode": fault.faultCode, "faultString": fault.faultString})
    return answers


def _params_for_master(
    agent: layers.AgentState, method: str, rule: CallRule, caller: str, params: tuple[object, ...]
) -> layers.Layer[tuple[object, ...] | None]:
    # The parameters for the secured master; None: the address is not the program's own.
    # `rosnode cleanup` names dead nodes; the master authorizes it.
    name = caller if method in registrations.UNREGISTERS else agent.name_for(caller)
    changed = list(params if name == caller else registrations.resolve_params(method, params, caller))
    changed[0] = name
    for index, protocol in ((rule.api, WireProtocol.HTTP), (rule.service, WireProtocol.TCPROS)):
        if index is None or index >= len(params):
            continue
        given = layers.parse_endpoint(params[index], protocol)
        if given is None:
            continue  # the master refuses it with a reason
        address = yield from _address(agent, method, given)
        if address is None:
            return None
        changed[index] = address
    own_api = _own_api(rule, params)
    if own_api is not None and method in registrations.REGISTERS:
        agent.endpoints.set_own_uri(own_api, str(params[rule.api or 0]))
        known = agent.programs.get(own_api)
        if known is None or known.name != caller:  # the port may have been reused
            agent.programs[own_api] = layers.Program(caller)
    return tuple(changed)


def _address(
    agent: layers.AgentState, method: str, given: layers.ListeningAddress
) -> layers.Layer[str | None]:
    # An egress port stands for a peer: `rosnode cleanup` sends the URI that `lookupNode` returned. No program
    # can register one as its own; the sidecar would call itself. Only who registers opens a port: who
    # unregisters may name that of a program that has ended, which another one has now.
    local = layers.local_endpoint(given.protocol, given.port)
    remote = agent.endpoints.peer_at(local)
    if method not in registrations.REGISTERS:
        return (remote or agent.endpoints.network_of(local)).uri
    return None if remote is not None else (yield from agent.ingress_endpoint(local)).uri


def _own_api(rule: CallRule, params: tuple[object, ...]) -> layers.ListeningAddress | None:
    if rule.api is None or rule.api >= len(params):
        return None
    return layers.own_endpoint(params[rule.api])


def _record_registration(
    agent: layers.AgentState,
    method: str,
    rule: CallRule,
    params: tuple[object, ...],
    master_params: tuple[object, ...],
    *,
    refused: bool = False,
) -> None:
    own_api = _own_api(rule, params)
    if method in registrations.REGISTERS and own_api is not None:
        program = agent.programs.setdefault(own_api, layers.Program(str(params[0])))
        program.registrations.record(method, master_params, refused=refused)
    elif method in registrations.UNREGISTERS:
        for program in agent.programs.values():
            program.registrations.record(method, master_params)


def _answer_for_program(
    agent: layers.AgentState, rule: CallRule, own_api: layers.ListeningAddress | None, answer: list[object]
) -> layers.Layer[list[object]]:
    code, status, value = answer
    match rule.result:
        case Result.NODES:
            value = yield from agent.egress_uris(value, own_api)
        case Result.NODE:
            remote = layers.parse_endpoint(value, WireProtocol.HTTP)
            if remote is None:
                value = ""
            else:
                own = agent.endpoints.program_at(remote)
                value = yield from agent.egress_uri(remote, own, probe=True)
        case Result.SERVICE:
            remote = layers.parse_endpoint(value, WireProtocol.TCPROS)
            value = "" if remote is None else (yield from agent.egress_uri(remote))
            status = f"rosrpc URI: [{value}]"
        case Result.MASTER:
            value = agent.master_uri
        case Result.PLAIN:
            pass
    return [code, status, value]


def restore(agent: layers.AgentState, holds: Holds) -> layers.Layer[None]:
    """Make every registration again with a restarted master, except those of dead programs."""
    # A dead program could replace a new one of the same name, which the master would shut down. One that was
    # refused before is made if this identity holds the right now.
    for own_api, program in tuple(agent.programs.items()):
        if (yield from _is_gone(agent, own_api, (yield layers.Probe(own_api)))):
            continue
        refused = program.registrations.refused()
        calls = [call for call in program.registrations if call not in refused]
        for method, params in (*calls, *_allowed(refused, holds)):
            yield from _register_again(agent, own_api, method, params)


def resubscribe(agent: layers.AgentState, topic: str) -> layers.Layer[None]:
    for own_api, program in tuple(agent.programs.items()):
        params = program.registrations.find(SUBSCRIBE, topic)
        if params is not None:
            yield from _register_again(agent, own_api, SUBSCRIBE, params)


def rights_changed(agent: layers.AgentState, holds: Holds) -> layers.Layer[None]:
    for own_api, program in tuple(agent.programs.items()):
        wanted = _allowed(program.registrations, holds)
        if wanted and not (yield from _is_gone(agent, own_api, (yield layers.Probe(own_api)))):
            for method, params in wanted:
                yield from _register_again(agent, own_api, method, params)


def _allowed(calls: Iterable[registrations.Call], holds: Holds) -> list[registrations.Call]:
    return [
        (method, params)
        for method, params in calls
        if method in _RIGHTS and holds(_RIGHTS[method], str(params[registrations.RELATIVE_NAME[method]]))
    ]


def _register_again(
    agent: layers.AgentState, own_api: layers.ListeningAddress, method: str, params: tuple[object, ...]
) -> layers.Layer[None]:
    event = yield layers.CallMaster(method, params)
    program = agent.programs.get(own_api)
    match event:
        case layers.Answered(value=[1, _, value]):
            if program is not None:
                program.registrations.record(method, params)
            if method == SUBSCRIBE:
                topic = str(params[registrations.RELATIVE_NAME[SUBSCRIBE]])
                publishers = agent.followed_publishers(topic, value)
                yield from _update_publishers(agent, own_api, topic, publishers)
        case layers.NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            pass


def drop_expired_publishers(agent: layers.AgentState) -> layers.Layer[None]:
    """Update the subscribers of topics whose publishers the master did not name again in time."""
    for topic in agent.publisher_grace.expired_topics():
        for own_api, program in tuple(agent.programs.items()):
            if program.registrations.find(SUBSCRIBE, topic) is not None:
                publishers = agent.publisher_grace.to_follow(topic)
                yield from _update_publishers(agent, own_api, topic, publishers)


def _update_publishers(
    agent: layers.AgentState, own_api: layers.ListeningAddress, topic: str, publishers: list[str]
) -> layers.Layer[None]:
    uris = yield from agent.egress_uris(publishers, own_api)
    yield from _is_gone(
        agent, own_api, (yield layers.CallProgram(own_api, "publisherUpdate", (MASTER, topic, uris)))
    )


def _is_gone(
    agent: layers.AgentState, own_api: layers.ListeningAddress, event: layers.Event
) -> layers.Layer[bool]:
    if isinstance(event, layers.NoAnswer) and event.dead:
        agent.forget(own_api)
        yield layers.Suspend(own_api)
        return True
    return False


class ResubscribeQueue:
    """The topics of one identity to resubscribe; times are seconds of one clock."""

    # rospy drops a connection that ended until it gets a publisherUpdate; the sidecar sends one once it
    # holds a grant again.

    def __init__(self) -> None:
        self._due: dict[str, float] = {}
        self._delays: dict[str, float] = {}

    def add(self, topic: str, began: float, now: float) -> None:
        """A connection for `topic`, made at `began`, has ended."""
        # The delay doubles while connections keep ending soon.
        lasted = now - began > MAX_DELAY
        delay = FIRST_DELAY if lasted else self._delays.get(topic, FIRST_DELAY)
        self._due[topic] = now + delay
        self._delays[topic] = min(2 * delay, MAX_DELAY)

    def take_due(self, now: float, may_subscribe: Callable[[str], bool]) -> list[str]:
        """The topics that are due; one without a grant waits until there is one."""
        due = [topic for topic, at in self._due.items() if at <= now and may_subscribe(topic)]
        for topic in due:
            del self._due[topic]
        return due
