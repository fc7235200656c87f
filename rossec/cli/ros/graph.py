"""`rossec graph | discover`, and what `rossec topic` and `rossec node` list of the graph."""

import asyncio
import socket
import time
from collections import defaultdict
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Final, TypeVar

import click

from ca.errors import CertificateExpired, HintedError
from ca.names import is_alias, local_name, shown
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.cli.completion import values
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import calls_as, find_master, master_at
from rossec.discovery import PATIENCE, masters, uri_of
from rossec.errors import AnswerMalformed, AnswerRefused, ConfigurationError
from rossec.home import NodeHome
from rossec.participant.registrations import WATCH_GRAPH, Fact, GraphView, ObservedChange
from rossec.participant.renewals import IdentityRenewal, MasterCall, renew_identity
from rossec.ros.names import ANY_TYPE
from rossec.terminal import note, printable, record, say, say_json

UNKNOWN = "unknown type"  # as rostopic has it
T = TypeVar("T")
Names = Mapping[str, tuple[str, ...]]
as_node = options.option("--as=NODE node", "identity to use", required=True)
_NAMESPACE = click.argument("namespace", required=False)
PAUSE: Final = 1.0  # seconds until the first reconnection
MAX_PAUSE: Final = 30.0  # seconds between later reconnections at most
_HEADINGS: Final = {"publisher": "published by", "subscriber": "subscribed by"}


@click.command("list")
@_NAMESPACE
@as_node
@options.flag("--verbose -v", "with types, and how many nodes")
@options.flag("--publishers -p", "only what is published")
@options.flag("--subscribers -s", "only what is subscribed to")
@options.as_json
@pass_environment
def list_topics(
    environment: Environment,
    namespace: str | None,
    node: str,
    verbose: bool,
    publishers: bool,
    subscribers: bool,
    as_json: bool,
) -> None:
    """List the topics that NODE may see, all or those below NAMESPACE."""
    state = system_state(environment, node)
    ways = {
        "publishers": {} if subscribers and not publishers else state.publishers,
        "subscribers": {} if publishers and not subscribers else state.subscribers,
    }
    top = "" if namespace is None else absolute(namespace).rstrip("/")
    all_topics = {topic for names in ways.values() for topic in names}
    topics = sorted(
        (each for each in all_topics if not top or f"{each}/".startswith(f"{top}/")), key=_own_first
    )

    def lines() -> Iterator[str]:
        if not verbose:
            yield from (printable(shown(topic)) for topic in topics)
            return
        for heading, way in (("Published", "publishers"), ("Subscribed", "subscribers")):
            yield ""
            yield f"{heading} topics:"
            for topic in topics:
                if count := len(ways[way].get(topic, ())):
                    many = f"{count} {way[:-1]}{'s' * (count != 1)}"
                    yield printable(f" * {shown(topic)} [{state.type_of(topic)}] {many}")
            yield ""

    options.say_result(as_json, [_row(state, topic) for topic in topics], lines())
    if not topics and namespace is None:
        note_hidden(node)


@dataclass(frozen=True)
class SystemState:
    publishers: Names
    subscribers: Names
    services: Names
    types: Mapping[str, str]

    @property
    def topics(self) -> list[str]:
        return sorted({*self.publishers, *self.subscribers})

    @property
    def nodes(self) -> list[str]:
        groups = (self.publishers, self.subscribers, self.services)
        return sorted({node for names in groups for nodes in names.values() for node in nodes})

    def type_of(self, topic: str) -> str:
        return self.types.get(topic, UNKNOWN)

    def keep_for_completion(self, environment: Environment) -> None:
        names = {
            values.NODE: self.nodes,
            values.SERVICE: sorted(self.services),
            values.TOPIC: self.topics,
            values.TYPE: sorted(set(self.types.values())),
        }
        values.keep(environment.home, environment.variables.get("ROS_MASTER_URI", ""), names)


def system_state(environment: Environment, node: str) -> SystemState:
    found = asyncio.run(_ask(environment, node, read_state))
    found.keep_for_completion(environment)
    return found


async def _ask(environment: Environment, node: str, question: Callable[[MasterCall], Awaitable[T]]) -> T:
    home = NodeHome.of(environment.home, node)
    async with calls_as(environment, home, await find_master(environment, home)) as call:
        return await question(call)


async def read_state(call: MasterCall) -> SystemState:
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


def absolute(name: str) -> str:
    """The absolute name of what a person wrote, as stock tools take it: from the root."""
    topic = local_name(name)
    return topic if topic.startswith("/") else f"/{topic}"


def _own_first(name: str) -> tuple[bool, str]:
    return is_alias(name), name


def _row(state: SystemState, topic: str) -> dict[str, object]:
    return {
        "topic": topic,
        "type": None if state.type_of(topic) == UNKNOWN else state.type_of(topic),
        "publishers": state.publishers.get(topic, ()),
        "subscribers": state.subscribers.get(topic, ()),
    }


def note_hidden(node: str) -> None:
    note(f"nothing that {node} may see; all of it needs: rossec grant sign {node} --graph")


@click.command()
@click.argument("name")
@as_node
@options.as_json
@pass_environment
def topic_info(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Show the type of the topic NAME and the nodes that publish and subscribe to it."""
    state = system_state(environment, node)
    topic = _known(state, name, node)
    if as_json:
        say_json(_row(state, topic))
        return
    groups = {"Publishers": state.publishers, "Subscribers": state.subscribers}
    found = {heading: list(names.get(topic, ())) for heading, names in groups.items()}
    uris = addresses(environment, node, sorted({name for names in found.values() for name in names}))
    say(f"Type: {state.type_of(topic)}")
    say("")
    for heading, nodes in found.items():
        say(f"{heading}: " if nodes else f"{heading}: None")
        for each in nodes:
            where = f" ({uris[each]})" if each in uris else ""
            say(printable(f" * {shown(each)}{where}"))
        say("")


def _known(state: SystemState, name: str, node: str) -> str:
    topic = absolute(name)
    if topic not in state.publishers and topic not in state.subscribers:
        raise ConfigurationError(
            f"no topic {shown(topic)} that {node} may see",
            f"rossec topic list --as {node} shows those that it may",
        )
    return topic


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


@click.command("type")
@click.argument("name")
@as_node
@options.json_result(pass_environment)
def type_of_topic(environment: Environment, name: str, node: str) -> None:
    """Print the type of the topic NAME."""
    state = system_state(environment, node)
    kind = state.type_of(_known(state, name, node))
    if kind == UNKNOWN:
        raise ConfigurationError(
            f"nobody has said the type of {name}", "it is known once somebody publishes it"
        )
    say(printable(kind), topic=absolute(name), type=kind)


@click.command()
@click.argument("type_name", metavar="TYPE")
@as_node
@options.json_result(pass_environment)
def find_topics(environment: Environment, type_name: str, node: str) -> None:
    """List the topics whose messages are of TYPE."""
    state = system_state(environment, node)
    found = [topic for topic in state.topics if state.type_of(topic) == type_name]
    record(type=type_name, topics=found)
    for topic in found:
        say(printable(shown(topic)))


@click.command("list")
@as_node
@options.as_json
@pass_environment
def list_nodes(environment: Environment, node: str, as_json: bool) -> None:
    """List the running nodes that NODE may see."""
    names = system_state(environment, node).nodes
    options.say_result(as_json, names, (printable(shown(name)) for name in names))
    if not names:
        note_hidden(node)


@click.command()
@click.argument("name")
@as_node
@options.as_json
@pass_environment
def node_info(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Show what the running node NAME publishes, subscribes to and provides."""
    state = system_state(environment, node)
    asked = local_name(name)
    if asked not in state.nodes:
        raise ConfigurationError(
            f"no running node {shown(asked)} that {node} may see",
            f"rossec node list --as {node} shows those that it may",
        )
    found = {
        "publications": _of(asked, state.publishers),
        "subscriptions": _of(asked, state.subscribers),
        "services": _of(asked, state.services),
    }
    uri = addresses(environment, node, [asked]).get(asked)
    if as_json:
        say_json({"node": asked, "uri": uri, **found})
        return
    say(printable(f"Node [{shown(asked)}]" + (f" at {uri}" if uri else "")))
    for heading, names in found.items():
        _say(heading.capitalize(), names, state if heading != "services" else None)


def _of(node: str, names: Names) -> list[str]:
    return sorted(name for name, nodes in names.items() if node in nodes)


def _say(heading: str, names: list[str], state: SystemState | None) -> None:
    say(f"{heading}: " if names else f"{heading}: None")
    for name in names:
        kind = f" [{state.type_of(name)}]" if state is not None else ""
        say(printable(f" * {shown(name)}{kind}"))
    say("")


@click.command()
@options.option("--as=NODE node", "identity to use", required=True)
@options.flag("--watch", "go on, and say what changes; ends with Ctrl-C")
@options.flag("--json as_json", "a line of JSON for each answer")
@pass_environment
def graph(environment: Environment, node: str, watch: bool, as_json: bool) -> None:
    """Show the graph, as far as NODE may see it.

    NODE needs the right graph on /master: rossec grant sign NODE --graph
    """
    home = NodeHome.of(environment.home, node)
    uri = master_at(environment, home)
    if watch:
        asyncio.run(_print_changes(environment, home, uri, as_json))
        return
    view = GraphView()

    async def look() -> None:
        async with calls_as(environment, home, uri) as call:
            while view.take(await call(WATCH_GRAPH, *view.next_params)).more:
                pass

    asyncio.run(look())
    found = ObservedChange(tuple(sorted(view.facts)), (), False, False)
    options.say_result(as_json, _json(view, found), describe(view.facts))


async def _print_changes(environment: Environment, home: NodeHome, uri: str, as_json: bool) -> None:
    view, pause, last_error = GraphView(), PAUSE, ""
    own = LiveCredentials(home.credentials())
    renewal = IdentityRenewal(home, own, now())
    # It goes on over restarts of the master, and over the end of its own identity, which it renews.
    while True:
        before = view.version
        try:
            async with calls_as(environment, home, uri, own.current) as call:
                while not await renew_identity(call, renewal, now()):
                    _print_change(view, view.take(await call(WATCH_GRAPH, *view.next_params)), as_json)
        except (HintedError, OSError, TimeoutError) as error:
            if view.version < 0:  # nothing was seen yet: what is wrong is wrong here, or there is no master
                raise
            try:
                home.identity(now())
            except CertificateExpired as expired:
                raise ConfigurationError(f"{expired}, and it was not renewed", expired.hint) from expired
            if before != view.version:
                pause, last_error = PAUSE, ""
            if str(error) != last_error:
                last_error = str(error)
                note(f"no graph changes received: {printable(last_error)}")
            await asyncio.sleep(pause)
            pause = min(2 * pause, MAX_PAUSE)


def _print_change(view: GraphView, change: ObservedChange, as_json: bool) -> None:
    if change.restarted and not as_json:
        note("the master has restarted")
    if not (change.added or change.removed or change.restarted):
        return
    if as_json:
        say_json(_json(view, change))
        return
    for sign, facts in (("-", change.removed), ("+", change.added)):
        for fact in facts:
            say(f"{sign} {printable(' '.join(map(shown, fact)))}")


def _json(view: GraphView, change: ObservedChange) -> dict[str, object]:
    return {
        "instance": view.instance,
        "version": view.version,
        "restarted": change.restarted,
        "added": change.added,
        "removed": change.removed,
    }


def describe(facts: frozenset[Fact]) -> list[str]:
    types = {name: value for kind, name, value in facts if kind == "type"}
    nodes: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for kind, name, value in sorted(facts):
        nodes[kind, name].append(value)
    lines: list[str] = []
    for topic in sorted({name for kind, name, _ in facts if kind in _HEADINGS}, key=_own_first):
        lines.append(f"{shown(topic)} ({types[topic]})" if topic in types else shown(topic))
        lines += [
            f"  {heading} {', '.join(map(shown, nodes[kind, topic]))}"
            for kind, heading in _HEADINGS.items()
            if nodes[kind, topic]
        ]
    for name in sorted({name for kind, name in nodes if kind == "service"}, key=_own_first):
        lines.append(f"{shown(name)} provided by {', '.join(map(shown, nodes['service', name]))}")
    return [printable(line) for line in lines]


@click.command()
@options.option("--as=NAME identity", "the node whose master is looked for")
@options.option(
    "--seconds",
    "how long to wait for the first",
    type=click.FloatRange(0.1, 600),
    default=PATIENCE,
    show_default=True,
)
@options.flag("--json as_json", "a line of JSON for each")
@pass_environment
def discover(environment: Environment, identity: str | None, seconds: float, as_json: bool) -> None:
    """Look for the masters of this trust domain, the best link first.

    Listens four seconds more than the first takes. Losses are counted by the numbers of the
    announcements, and by the time since the last: the loss of a dead master grows.

    `ROS_MASTER_URI=discover:` makes every command take the first one.
    """
    with options.working("listening for masters", quiet=as_json):
        found = asyncio.run(masters(environment.home, identity, seconds))
    for one in found:
        link, clock = str(one.source.link), time.monotonic()
        with suppress(OSError):
            link = socket.if_indextoname(one.source.link)
        row = {
            "uri": uri_of(one),
            "name": one.name,
            "rtt_ms": round((one.rtt or 0) * 1000, 2),
            "loss": round(one.loss(clock), 2),
            "heard": len(one.heard),
            "sent": one.sent(clock),
            "age_s": round(one.age(clock), 1),
            "link": link,
            "key": one.key.hex(),
        }
        if as_json:
            say_json(row)
        else:
            say(
                f"{row['uri']}  {row['name']}  {row['rtt_ms']} ms,"
                f" {row['loss']:.0%} of {row['sent']} lost,"
                f" heard {row['age_s']} s ago, on {row['link']}"
            )
