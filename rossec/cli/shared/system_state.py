"""The graph as ROS 1's tools ask for it: getSystemState and getTopicTypes, as a node may see it."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from dataclasses import dataclass
from typing import TypeVar

import click

from rossec.cli.completion import seen
from rossec.cli.shared.context import Environment
from rossec.cli.shared.master import calls_as, find_master
from rossec.errors import AnswerMalformed, AnswerRefused
from rossec.home import NodeHome
from rossec.participant.grant_renewal import MasterCall
from rossec.ros.names import ANY_TYPE
from rossec.terminal import note

UNKNOWN = "unknown type"  # as rostopic has it
T = TypeVar("T")
Names = Mapping[str, tuple[str, ...]]

as_node = click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
as_json = click.option("--json", "as_json", is_flag=True, help="one line of JSON")


@dataclass(frozen=True)
class SystemState:
    """Who publishes, subscribes and provides what: names of nodes by topic or service."""

    publishers: Names
    subscribers: Names
    services: Names
    types: Mapping[str, str]

    @property
    def topics(self) -> list[str]:
        """Every topic that somebody publishes or subscribes to."""
        return sorted({*self.publishers, *self.subscribers})

    @property
    def nodes(self) -> list[str]:
        """Every node that publishes, subscribes or provides something."""
        groups = (self.publishers, self.subscribers, self.services)
        return sorted({node for names in groups for nodes in names.values() for node in nodes})

    def type_of(self, topic: str) -> str:
        """The type of a topic's messages."""
        return self.types.get(topic, UNKNOWN)


def system_state(environment: Environment, node: str) -> SystemState:
    """The state of the master that ROS_MASTER_URI names, as far as `node` may see it.

    Raises:
        HintedError, OSError, TimeoutError: the master is unreachable, or answers wrongly.
    """
    found = asyncio.run(_ask(environment, node, read_state))
    _keep_for_completion(environment, found)
    return found


def _keep_for_completion(environment: Environment, found: SystemState) -> None:
    """Tab completes these names from now on, and asks no master itself."""
    names = {
        seen.NODE: found.nodes,
        seen.SERVICE: sorted(found.services),
        seen.TOPIC: found.topics,
        seen.TYPE: sorted(set(found.types.values())),
    }
    seen.keep(environment.home, environment.variables.get("ROS_MASTER_URI", ""), names)


def addresses(environment: Environment, node: str, names: list[str]) -> dict[str, str]:
    """The slave API of each of these nodes; one that `node` may not look up is left out."""

    async def look_up(call: MasterCall) -> dict[str, str]:
        found: dict[str, str] = {}
        for name in names:
            try:
                uri = await call("lookupNode", name)
            except AnswerRefused:
                continue
            found |= {name: uri} if isinstance(uri, str) else {}
        return found

    return asyncio.run(_ask(environment, node, look_up))


def note_hidden(node: str) -> None:
    """Say why a list may be empty."""
    note(f"nothing that {node} may see; all of it needs: rossec grant sign {node} --graph")


async def _ask(
    environment: Environment, node: str, question: Callable[[MasterCall], Awaitable[T]]
) -> T:
    home = NodeHome.of(environment.home, node)
    async with calls_as(environment, home, await find_master(environment, home)) as call:
        return await question(call)


async def read_state(call: MasterCall) -> SystemState:
    """Ask both questions on one connection.

    Raises:
        AnswerMalformed: not what these calls answer.
    """
    match await call("getSystemState"):
        case [list() as publishers, list() as subscribers, list() as services]:
            groups = _names(publishers), _names(subscribers), _names(services)
        case _:
            raise AnswerMalformed("an invalid system state")
    types = await call("getTopicTypes")
    return SystemState(*groups, dict(map(_type, types if isinstance(types, list) else [types])))


def _names(rows: list[object]) -> Names:
    found: dict[str, tuple[str, ...]] = {}
    for row in rows:
        match row:
            case [str() as name, list() as nodes]:
                found[name] = tuple(sorted(node for node in nodes if isinstance(node, str)))
            case _:
                raise AnswerMalformed("an invalid system state")
    return found


def _type(row: object) -> tuple[str, str]:
    match row:
        case [str() as topic, str() as kind]:
            return topic, UNKNOWN if kind == ANY_TYPE else kind
        case _:
            raise AnswerMalformed("a list of topics that is malformed")
