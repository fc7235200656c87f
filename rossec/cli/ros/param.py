"""`rossec param`: read and write parameters from the command line, with an identity."""

import asyncio
import base64
import shlex
from collections.abc import Awaitable, Callable
from typing import Any

import click

from ca.domains.aliases import local_name, shown
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as
from rossec.cli.shared.message_text import parse_message
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.node.params import NodeParameters
from rossec.terminal import json_text, printable, record, say, say_block, say_json

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
        say_block(_readable(value))


@click.command("set")
@click.argument("name")
@click.argument("values", metavar="VALUE", nargs=-1, required=True)
@_AS
@json_result()
@pass_environment
def set_(environment: Environment, name: str, values: tuple[str, ...], node: str) -> None:
    """Set the parameter NAME to VALUE (YAML, as in rosparam)."""
    if len(values) > 1:
        raise ConfigurationError(
            f"the shell made {len(values)} words of the value",
            f"put it in single quotes: {shlex.quote(' '.join(values))}",
        )
    content = parse_message(values[0])
    if content is None:
        raise ConfigurationError(
            "a parameter cannot be null", f"unset it: rossec param delete {name} --as NODE"
        )
    key = local_name(name)
    _run(environment, node, lambda params: params.set(key, content))
    record(name=key, value=_encodable(content))


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@_AS
@json_result()
@pass_environment
def delete(environment: Environment, names: tuple[str, ...], node: str) -> None:
    """Unset the parameter NAME and everything below it."""
    keys = unique([local_name(name) for name in names])
    batch = Batch(len(keys), "name")

    async def work(params: NodeParameters) -> None:
        for key in keys:
            with batch.item(key):
                await params.delete(key)

    _run(environment, node, work)
    batch.finish()


def _run(
    environment: Environment, node: str, work: Callable[[NodeParameters], Awaitable[Any]]
) -> Any:
    async def run() -> Any:
        async with node_as(environment, node) as running:
            return await work(running.params)

    return asyncio.run(run())


def _readable(value: object) -> str:
    """A value on one line; lists and mappings as JSON, which escapes control characters."""
    if isinstance(value, str):
        return printable(value)
    return json_text(_encodable(value), 2 if isinstance(value, dict) else None)


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
