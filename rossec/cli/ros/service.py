"""`rossec service`: see and call services from the command line, with an identity."""

import asyncio
from pathlib import Path

import click

from ca.domains.aliases import local_name, shown
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as
from rossec.cli.shared.message_output import plain, render
from rossec.cli.shared.message_text import fill, parse_arguments, stamp_now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.running import run_until_node_ends
from rossec.errors import ConfigurationError
from rossec.node import ServiceClient, register_service_type, service_type
from rossec.participant.header_fields import text
from rossec.participant.message_types import Message
from rossec.participant.remote_names import caller_here
from rossec.terminal import printable, record, say, say_block, say_json

_AS = click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
_JSON = click.option("--json", "as_json", is_flag=True, help="one line of JSON")


@click.command("list")
@_AS
@_JSON
@pass_environment
def list_(environment: Environment, node: str, as_json: bool) -> None:
    """List the services that NODE may see."""
    asyncio.run(_list(environment, node, as_json))


@click.command()
@click.argument("name")
@_AS
@_JSON
@pass_environment
def info(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Show which node provides the service NAME, where, and its type."""
    asyncio.run(_info(environment, name, node, as_json))


@click.command("type")
@click.argument("name")
@_AS
@json_result()
@pass_environment
def type_(environment: Environment, name: str, node: str) -> None:
    """Print the type of the service NAME."""
    asyncio.run(_type(environment, name, node))


@click.command()
@click.argument("name")
@click.argument("content", nargs=-1)
@_AS
@click.option("--type", "type_name", metavar="PKG/TYPE", help="instead of asking the provider")
@click.option(
    "--definition",
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
    help="the .srv file of that type, unless it is a standard one",
)
@click.option(
    "--timeout",
    type=click.FloatRange(min=0, min_open=True),
    default=60.0,
    show_default=True,
    help="seconds to wait for the answer",
)
@_JSON
@pass_environment
def call(
    environment: Environment,
    name: str,
    content: tuple[str, ...],
    node: str,
    type_name: str | None,
    definition: Path | None,
    timeout: float,
    as_json: bool,
) -> None:
    """Call the service NAME with CONTENT (YAML, as in rosservice) and print the answer."""
    content_fields = parse_arguments(content)
    if definition is not None:
        _register_definition(type_name, definition)
    asyncio.run(_call(environment, name, content_fields, node, type_name, timeout, as_json))


def _register_definition(type_name: str | None, definition: Path) -> None:
    if type_name is None:
        raise ConfigurationError("a definition without its name", "give --type PKG/TYPE as well")
    try:
        content = definition.read_text()
    except UnicodeDecodeError:
        raise ConfigurationError(f"{definition} is not text", "give a .srv file") from None
    register_service_type(type_name, content)


async def _list(environment: Environment, node: str, as_json: bool) -> None:
    async with node_as(environment, node) as running:
        known = await running.services.known()
    if as_json:
        say_json(known)
        return
    for name in sorted(known):
        say(printable(shown(name)))


async def _info(environment: Environment, name: str, own: str, as_json: bool) -> None:
    async with node_as(environment, own) as running:
        name = running.settings.resolve(local_name(name))
        uri = await running.services.lookup(name)
        fields, provider = await running.services.probe(name)
    node = caller_here(provider, text(fields, "callerid"))
    found = {
        "node": node,
        "uri": uri,
        "type": text(fields, "type"),
        "md5sum": text(fields, "md5sum"),
    }
    if node != provider.name:
        found["identity"] = provider.name
    if as_json:
        say_json(found)
        return
    for key, value in found.items():
        say(f"{key}: {printable(shown(value))}")


async def _type(environment: Environment, name: str, own: str) -> None:
    async with node_as(environment, own) as running:
        fields, _ = await running.services.probe(running.settings.resolve(local_name(name)))
    record(service=local_name(name), type=text(fields, "type"))
    say(printable(text(fields, "type")))


async def _call(
    environment: Environment,
    name: str,
    content_fields: object,
    node: str,
    type_name: str | None,
    timeout: float,  # noqa: ASYNC109 - as the option
    as_json: bool,
) -> None:
    name = local_name(name)
    async with node_as(environment, node) as running:
        if type_name is None:
            fields, _ = await running.services.probe(running.settings.resolve(name))
            type_name = text(fields, "type")
        service_type(type_name)
        client = running.client(name, type_name, deadline=timeout)
        request = client.create()
        fill(request, content_fields, stamp_now())
        await run_until_node_ends(running, _answer(client, request, as_json))


async def _answer(client: ServiceClient, request: Message, as_json: bool) -> None:
    response = await client(request)
    if as_json:
        say_json(plain(response))
    elif (said := render(response)) != "":
        say_block(said)
