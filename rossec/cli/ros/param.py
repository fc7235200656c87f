"""`rossec param`: read and write parameters from the command line, with an identity."""

import asyncio
import base64
import json
from collections.abc import Awaitable, Callable
from typing import Any

import click

from ca.domains.aliases import local_name, shown
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.message_text import parse_message
from rossec.errors import ConfigurationError
from rossec.node import Node
from rossec.node.params import NodeParameters
from rossec.terminal import printable, say, say_json

_AS = click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
_JSON = click.option("--json", "as_json", is_flag=True, help="one line of JSON")


@click.command("list")
@click.argument("namespace", default="/")
@_AS
@_JSON
@pass_environment
def list_(environment: Environment, namespace: str, node: str, as_json: bool) -> None:
    """List the parameters that NODE may read, of all or of one NAMESPACE."""
    names = _run(environment, node, lambda params: params.names())
    prefix = local_name(namespace).rstrip("/") + "/"
    found = sorted(name for name in names if f"{name}/".startswith(prefix))
    if as_json:
        say_json(found)
        return
    for name in found:
        say(printable(shown(name)))


@click.command()
@click.argument("name")
@_AS
@_JSON
@pass_environment
def get(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Print the parameter NAME, or a namespace with all in it."""
    key = local_name(name)
    value = _run(environment, node, lambda params: params.get(key))
    if as_json:
        say_json(_encodable(value))
    else:
        say(_readable(value))


@click.command("set")
@click.argument("name")
@click.argument("value")
@_AS
@pass_environment
def set_(environment: Environment, name: str, value: str, node: str) -> None:
    """Set the parameter NAME to VALUE (YAML, as in rosparam)."""
    content = parse_message(value)
    if content is None:
        raise ConfigurationError(
            "a parameter cannot be null", f"rossec param delete {name} unsets it"
        )
    key = local_name(name)
    _run(environment, node, lambda params: params.set(key, content))


@click.command()
@click.argument("name")
@_AS
@pass_environment
def delete(environment: Environment, name: str, node: str) -> None:
    """Unset the parameter NAME and everything below it."""
    key = local_name(name)
    _run(environment, node, lambda params: params.delete(key))


def _run(
    environment: Environment, node: str, work: Callable[[NodeParameters], Awaitable[Any]]
) -> Any:
    async def run() -> Any:
        async with Node(node, environ=environment.variables) as running:
            return await work(running.params)

    return asyncio.run(run())


def _readable(value: object) -> str:
    """A value on one line; lists and mappings as JSON, which escapes control characters."""
    if isinstance(value, str):
        return printable(value)
    return json.dumps(_encodable(value), indent=2 if isinstance(value, dict) else None)


def _encodable(value: object) -> object:
    """The value as JSON has it: bytes as base64, times as text."""
    match value:
        case dict():
            return {str(key): _encodable(below) for key, below in value.items()}
        case list():
            return [_encodable(item) for item in value]
        case bytes():
            return base64.b64encode(value).decode()
        case bool() | int() | float() | str():
            return value
        case _:
            return str(value)
