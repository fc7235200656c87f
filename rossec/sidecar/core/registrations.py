"""The stored registrations of programs, made again, and publisher updates for them. Pure layers.

For a restarted master, for topics whose connection ended, for rights that are new, and for
publishers that the master did not name again within their grace period.
"""

from collections.abc import Callable, Iterable
from typing import Final, TypeAlias

from grants.model import Right
from rossec.errors import HangUp
from rossec.participant.caller_names import RELATIVE_NAME
from rossec.participant.registrations import Call
from rossec.ros.names import MASTER
from rossec.sidecar.core.commands import CallMaster, CallProgram, Probe, Suspend
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.core.events import Answered, Event, NoAnswer
from rossec.sidecar.core.layers import AgentState, Layer
from rossec.sidecar.core.master_calls import SUBSCRIBE

_RIGHTS: Final = {
    "registerPublisher": Right.PUBLISH, SUBSCRIBE: Right.SUBSCRIBE, "registerService": Right.PROVIDE
}  # fmt: skip


Holds: TypeAlias = Callable[[Right, str], bool]
"""Whether this identity has a right on a name now; without it the master would only refuse."""


def restore(agent: AgentState, holds: Holds) -> Layer[None]:
    """Make every registration again with a restarted master, except those of dead programs.

    A dead program could replace a new one of the same name, which the master would shut down. One
    that was refused before is made if this identity `holds` the right now.
    """
    for own_api, program in tuple(agent.programs.items()):
        if (yield from _is_gone(agent, own_api, (yield Probe(own_api)))):
            continue
        refused = program.registrations.refused()
        calls = [call for call in program.registrations if call not in refused]
        for method, params in (*calls, *_allowed(refused, holds)):
            yield from _register_again(agent, own_api, method, params)


def resubscribe(agent: AgentState, topic: str) -> Layer[None]:
    """Send the publishers of `topic` to its subscribers again: rospy needs it to reconnect."""
    for own_api, program in tuple(agent.programs.items()):
        params = program.registrations.find(SUBSCRIBE, topic)
        if params is not None:
            yield from _register_again(agent, own_api, SUBSCRIBE, params)


def rights_changed(agent: AgentState, holds: Holds) -> Layer[None]:
    """Make the registrations again that may have been refused or removed for lack of a right."""
    for own_api, program in tuple(agent.programs.items()):
        wanted = _allowed(program.registrations, holds)
        if wanted and not (yield from _is_gone(agent, own_api, (yield Probe(own_api)))):
            for method, params in wanted:
                yield from _register_again(agent, own_api, method, params)


def _allowed(calls: Iterable[Call], holds: Holds) -> list[Call]:
    """Those of `calls` that this identity has the right to."""
    return [
        (method, params)
        for method, params in calls
        if method in _RIGHTS and holds(_RIGHTS[method], str(params[RELATIVE_NAME[method]]))
    ]


def _register_again(
    agent: AgentState, own_api: Endpoint, method: str, params: tuple[object, ...]
) -> Layer[None]:
    event = yield CallMaster(method, params)
    program = agent.programs.get(own_api)
    match event:
        case Answered(value=[1, _, _]) if program is not None:
            program.registrations.record(method, params)
        case _:
            pass
    match event:
        case Answered(value=[1, _, value]) if method == SUBSCRIBE:
            topic = str(params[RELATIVE_NAME[SUBSCRIBE]])
            publishers = agent.followed_publishers(topic, value)
            yield from _update_publishers(agent, own_api, topic, publishers)
        case NoAnswer(reason=reason):
            raise HangUp(reason)
        case _:
            pass


def drop_expired_publishers(agent: AgentState) -> Layer[None]:
    """Update the subscribers of topics whose publishers the master did not name again in time."""
    for topic in agent.publisher_grace.expired_topics():
        for own_api, program in tuple(agent.programs.items()):
            if program.registrations.find(SUBSCRIBE, topic) is not None:
                publishers = agent.publisher_grace.to_follow(topic)
                yield from _update_publishers(agent, own_api, topic, publishers)


def _update_publishers(
    agent: AgentState, own_api: Endpoint, topic: str, publishers: list[str]
) -> Layer[None]:
    """Send a publisherUpdate to a program that may have ended."""
    uris = yield from agent.egress_uris(publishers, own_api)
    yield from _is_gone(
        agent, own_api, (yield CallProgram(own_api, "publisherUpdate", (MASTER, topic, uris)))
    )


def _is_gone(agent: AgentState, own_api: Endpoint, event: Event) -> Layer[bool]:
    if isinstance(event, NoAnswer) and event.dead:
        agent.forget(own_api)
        yield Suspend(own_api)
        return True
    return False
