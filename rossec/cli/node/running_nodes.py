"""`rossec node list | info`: the nodes that run, as the master shows them to a node."""

import click

from ca.domains.aliases import local_name, shown
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.system_state import (
    Names,
    SystemState,
    addresses,
    as_json,
    as_node,
    note_hidden,
    system_state,
)
from rossec.errors import ConfigurationError
from rossec.terminal import printable, say, say_json


@click.command("list")
@as_node
@as_json
@pass_environment
def list_(environment: Environment, node: str, as_json: bool) -> None:
    """List the running nodes that NODE may see."""
    names = system_state(environment, node).nodes
    if as_json:
        say_json(names)
    else:
        for name in names:
            say(printable(shown(name)))
    if not names:
        note_hidden(node)


@click.command()
@click.argument("name")
@as_node
@as_json
@pass_environment
def info(environment: Environment, name: str, node: str, as_json: bool) -> None:
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
