"""`rossec service`, `rossec param`: services and parameters from the command line, with an identity."""

import asyncio
import base64
import shlex
from collections.abc import Awaitable, Callable, Mapping
from pathlib import Path
from typing import TypeVar

import click

from ca.certificates import Identity
from ca.names import local_name, shown
from rossec.cli.ros.topic import run_until_node_ends
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as
from rossec.cli.shared.messages import fill, parse_arguments, parse_message, plain, render, stamp_now
from rossec.errors import ConfigurationError
from rossec.node import Node, register_service_type, service_type
from rossec.participant.handshakes import caller_here, text
from rossec.terminal import json_text, printable, record, say, say_block, say_json

_AS = options.option("--as=NODE node", "identity to use", required=True)
T = TypeVar("T")


@click.command("list")
@_AS
@options.as_json
@pass_environment
def list_services(environment: Environment, node: str, as_json: bool) -> None:
    """List the services that NODE may see."""
    known = _run(environment, node, lambda running: running.services.known())
    options.say_result(as_json, known, (printable(shown(name)) for name in sorted(known)))


def _run(environment: Environment, node: str, work: Callable[[Node], Awaitable[T]]) -> T:
    async def run() -> T:
        async with node_as(environment, node) as running:
            return await work(running)

    return asyncio.run(run())


@click.command()
@click.argument("name")
@_AS
@options.as_json
@pass_environment
def service_info(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Show which node provides the service NAME, where, and its type."""

    async def ask(running: Node) -> tuple[str, Mapping[str, bytes], Identity]:
        absolute = running.settings.resolve(local_name(name))
        return await running.services.lookup(absolute), *await running.services.probe(absolute)

    uri, fields, provider = _run(environment, node, ask)
    caller = caller_here(provider, text(fields, "callerid"))
    found = {"node": caller, "uri": uri, "type": text(fields, "type"), "md5sum": text(fields, "md5sum")}
    if caller != provider.name:
        found["identity"] = provider.name
    options.say_result(as_json, found, (f"{key}: {printable(shown(value))}" for key, value in found.items()))


@click.command("type")
@click.argument("name")
@_AS
@options.json_result(pass_environment)
def type_of_service(environment: Environment, name: str, node: str) -> None:
    """Print the type of the service NAME."""
    service = local_name(name)
    fields, _ = _run(
        environment, node, lambda running: running.services.probe(running.settings.resolve(service))
    )
    say(printable(text(fields, "type")), service=service, type=text(fields, "type"))


@click.command()
@click.argument("name")
@click.argument("content", nargs=-1)
@_AS
@options.option("--type=PKG/TYPE type_name", "instead of asking the provider")
@options.option("--definition", "the .srv file of that type, unless it is a standard one", type=options.FILE)
@options.option(
    "--timeout",
    "seconds to wait for the answer",
    type=click.FloatRange(min=0, min_open=True),
    default=60.0,
    show_default=True,
)
@options.as_json
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
    content_fields, service = parse_arguments(content), local_name(name)
    if definition is not None:
        if type_name is None:
            raise ConfigurationError("a definition without its name", "give --type PKG/TYPE as well")
        try:
            register_service_type(type_name, definition.read_text())
        except UnicodeDecodeError:
            raise ConfigurationError(f"{definition} is not text", "give a .srv file") from None

    async def work(running: Node) -> None:
        kind = type_name
        if kind is None:
            fields, _ = await running.services.probe(running.settings.resolve(service))
            kind = text(fields, "type")
        service_type(kind)  # refuses a type that is not known here, before anything is sent
        client = running.client(service, kind, deadline=timeout)
        request = client.create()
        fill(request, content_fields, stamp_now())

        async def answer() -> None:
            response = await client(request)
            if as_json:
                say_json(plain(response))
            elif (said := render(response)) != "":
                say_block(said)

        await run_until_node_ends(running, answer())

    _run(environment, node, work)


@click.command("list")
@click.argument("namespace", default="/")
@_AS
@options.as_json
@pass_environment
def list_params(environment: Environment, namespace: str, node: str, as_json: bool) -> None:
    """List the parameters that NODE may read, of all or of one NAMESPACE."""
    names = _run(environment, node, lambda running: running.params.names())
    prefix = local_name(namespace).rstrip("/") + "/"
    found = sorted(name for name in names if f"{name}/".startswith(prefix))
    options.say_result(as_json, found, (printable(shown(name)) for name in found))


@click.command()
@click.argument("name")
@_AS
@options.as_json
@pass_environment
def get_param(environment: Environment, name: str, node: str, as_json: bool) -> None:
    """Print the parameter NAME, or a namespace with all in it."""
    key = local_name(name)
    value = _run(environment, node, lambda running: running.params.get(key))
    if as_json:
        say_json(_encodable(value))
    elif isinstance(value, str):
        say_block(printable(value))
    else:
        say_block(json_text(_encodable(value), 2 if isinstance(value, dict) else None))


def _encodable(value: object) -> object:
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


@click.command("set")
@click.argument("name")
@click.argument("values", metavar="VALUE", nargs=-1, required=True)
@_AS
@options.json_result(pass_environment)
def set_param(environment: Environment, name: str, values: tuple[str, ...], node: str) -> None:
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
    _run(environment, node, lambda running: running.params.set(key, content))
    record(name=key, value=_encodable(content))


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@_AS
@options.json_result(pass_environment)
def delete_param(environment: Environment, names: tuple[str, ...], node: str) -> None:
    """Unset the parameter NAME and everything below it."""
    keys = options.unique([local_name(name) for name in names])
    batch = options.Batch(len(keys), "name")

    async def work(running: Node) -> None:
        for key in keys:
            with batch.item(key):
                await running.params.delete(key)

    _run(environment, node, work)
    batch.finish()
