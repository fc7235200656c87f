"""`rossec topic list | info | type | find`: topics as the master shows them to a node."""

import click

from ca.domains.aliases import is_alias, local_name, shown
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.system_state import (
    UNKNOWN,
    Names,
    SystemState,
    addresses,
    as_json,
    as_node,
    note_hidden,
    system_state,
)
from rossec.errors import ConfigurationError
from rossec.terminal import printable, record, say, say_json

_NAMESPACE = click.argument("namespace", required=False)


@click.command("list")
@_NAMESPACE
@as_node
@click.option("--verbose", "-v", is_flag=True, help="with types, and how many nodes")
@click.option("--publishers", "-p", is_flag=True, help="only what is published")
@click.option("--subscribers", "-s", is_flag=True, help="only what is subscribed to")
@as_json
@pass_environment
def list_(
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
    listed = {topic for names in ways.values() for topic in names if _lies_in(topic, namespace)}
    topics = sorted(listed, key=_own_first)
    if as_json:
        say_json([_row(state, topic) for topic in topics])
    elif verbose:
        for heading, way in (("Published", "publishers"), ("Subscribed", "subscribers")):
            _say_verbose(heading, way[:-1], ways[way], topics, state)
    else:
        for topic in topics:
            say(printable(shown(topic)))
    if not topics and namespace is None:
        note_hidden(node)


@click.command()
@click.argument("name")
@as_node
@as_json
@pass_environment
def info(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Show the type of the topic NAME and the nodes that publish and subscribe to it."""
    state = system_state(environment, node)
    topic = _known(state, name, node)
    if as_json:
        say_json(_row(state, topic))
        return
    groups = {"Publishers": state.publishers, "Subscribers": state.subscribers}
    found = {heading: list(names.get(topic, ())) for heading, names in groups.items()}
    uris = addresses(
        environment, node, sorted({name for names in found.values() for name in names})
    )
    say(f"Type: {state.type_of(topic)}")
    say("")
    for heading, nodes in found.items():
        say(f"{heading}: " if nodes else f"{heading}: None")
        for each in nodes:
            where = f" ({uris[each]})" if each in uris else ""
            say(printable(f" * {shown(each)}{where}"))
        say("")


@click.command("type")
@click.argument("name")
@as_node
@json_result()
@pass_environment
def type_(environment: Environment, name: str, node: str) -> None:
    """Print the type of the topic NAME."""
    state = system_state(environment, node)
    kind = state.type_of(_known(state, name, node))
    if kind == UNKNOWN:
        raise ConfigurationError(
            f"nobody has said the type of {name}", "it is known once somebody publishes it"
        )
    record(topic=absolute(name), type=kind)
    say(printable(kind))


@click.command()
@click.argument("type_name", metavar="TYPE")
@as_node
@json_result()
@pass_environment
def find(environment: Environment, type_name: str, node: str) -> None:
    """List the topics whose messages are of TYPE."""
    state = system_state(environment, node)
    found = [topic for topic in state.topics if state.type_of(topic) == type_name]
    record(type=type_name, topics=found)
    for topic in found:
        say(printable(shown(topic)))


def _known(state: SystemState, name: str, node: str) -> str:
    topic = absolute(name)
    if topic not in state.publishers and topic not in state.subscribers:
        raise ConfigurationError(
            f"no topic {shown(topic)} that {node} may see",
            f"rossec topic list --as {node} shows those that it may",
        )
    return topic


def absolute(name: str) -> str:
    """The absolute name of what a person wrote, as stock tools take it: from the root."""
    topic = local_name(name)
    return topic if topic.startswith("/") else f"/{topic}"


def _lies_in(topic: str, namespace: str | None) -> bool:
    if namespace is None:
        return True
    top = absolute(namespace).rstrip("/")
    return topic == top or topic.startswith(f"{top}/")


def _row(state: SystemState, topic: str) -> dict[str, object]:
    return {
        "topic": topic,
        "type": None if state.type_of(topic) == UNKNOWN else state.type_of(topic),
        "publishers": state.publishers.get(topic, ()),
        "subscribers": state.subscribers.get(topic, ()),
    }


def _say_verbose(
    heading: str, one: str, names: Names, topics: list[str], state: SystemState
) -> None:
    say("")
    say(f"{heading} topics:")
    for topic in topics:
        if count := len(names.get(topic, ())):
            many = f"{count} {one}{'s' * (count != 1)}"
            say(printable(f" * {shown(topic)} [{state.type_of(topic)}] {many}"))
    say("")


def _own_first(name: str) -> tuple[bool, str]:
    return is_alias(name), name
