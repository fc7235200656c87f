"""`rossec topic`: publish and listen from the command line, with an identity."""

import asyncio
from collections.abc import Coroutine
from typing import Any

import click
import numpy as np

from grants import yamltext
from grants.errors import YamlRefused
from rossec.cli.context import Environment, pass_environment
from rossec.cli.voice import note, printable, say
from rossec.errors import ConfigurationError
from rossec.node import Node, Publisher
from rossec.node.messages import Message, field_names, message_type

_SHOWN = 60  # characters of what was typed


@click.group()
def topic() -> None:
    """Publish and listen."""


@topic.command()
@click.argument("name")
@click.argument("type_name", metavar="TYPE")
@click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
@click.option("--count", "-n", type=click.IntRange(min=1), help="end after this many messages")
@pass_environment
def echo(environment: Environment, name: str, type_name: str, node: str, count: int | None) -> None:
    """Print the messages of the topic NAME, as NODE may see them."""
    asyncio.run(_echo(environment, name, type_name, node, count))


@topic.command()
@click.argument("name")
@click.argument("type_name", metavar="TYPE")
@click.argument("content", default="{}")
@click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
@click.option(
    "--rate",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    show_default=True,
    help="messages per second",
)
@click.option("--count", "-n", type=click.IntRange(min=1), help="end after this many messages")
@pass_environment
def pub(
    environment: Environment,
    name: str,
    type_name: str,
    content: str,
    node: str,
    rate: float,
    count: int | None,
) -> None:
    """Publish CONTENT (YAML, as in rostopic) on the topic NAME."""
    message = message_type(type_name).create()
    fill(message, parse_message(content))
    asyncio.run(_pub(environment, name, type_name, node, message, 1 / rate, count))


async def _echo(
    environment: Environment, name: str, type_name: str, node: str, count: int | None
) -> None:
    async with Node(node, environ=environment.variables) as running:
        subscriber = await running.subscriber(name, type_name)
        await until(running, _print(subscriber, count))


async def _print(subscriber: Any, count: int | None) -> None:
    seen = 0
    async for message in subscriber:
        say(render(message))
        say("---")
        seen += 1
        if seen == count:
            return


async def _pub(
    environment: Environment,
    name: str,
    type_name: str,
    node: str,
    message: Message,
    period: float,
    count: int | None,
) -> None:
    async with Node(node, environ=environment.variables) as running:
        publisher = await running.publisher(name, type_name)
        note(f"waiting for a subscriber of {publisher.topic}")
        await until(running, _publish(publisher, message, period, count))


async def _publish(
    publisher: Publisher, message: Message, period: float, count: int | None
) -> None:
    await publisher.wait_for_subscribers()
    sent = 0
    while count is None or sent < count:
        publisher.publish(message)
        sent += 1
        await asyncio.sleep(period)


async def until(node: Node, work: Coroutine[Any, Any, None]) -> None:
    """Work until it is done, or until the node ends by itself: that is an error then.

    Nothing works on when this ends, however it ends: Ctrl-C closes the node next.
    """
    tasks = [asyncio.ensure_future(node.wait_ended()), asyncio.ensure_future(work)]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    for task in done:
        await task


def fill(message: Message, content: object) -> None:
    """Set the fields of `message` that the mapping `content` names, nested ones too.

    Raises:
        ConfigurationError: a field that is not there, or a value where a mapping is needed.
    """
    if not isinstance(content, dict):
        raise ConfigurationError("a message is a mapping of fields", "for example '{data: hello}'")
    for field, value in content.items():
        if field not in field_names(message):
            name = message.__msgtype__.replace("/msg/", "/")
            raise ConfigurationError(
                f"no field {field!r} in {name}", f"it has {', '.join(field_names(message))}"
            )
        current = getattr(message, field)
        if hasattr(current, "__msgtype__"):
            fill(current, value)
        else:
            setattr(message, field, _like(field, current, value))


def _like(field: str, current: Any, value: object) -> object:
    """`value` as the type the field has."""
    try:
        if isinstance(current, np.ndarray):
            return np.asarray(value, dtype=current.dtype)
        if isinstance(current, float) and isinstance(value, int):
            return float(value)
    except (ValueError, TypeError, OverflowError) as error:
        raise ConfigurationError(f"{field}: {error}") from error
    if type(value) is not type(current):
        raise ConfigurationError(
            f"{field} is of type {type(current).__name__}, not {type(value).__name__}"
        )
    return value


def render(message: Message, indent: int = 0) -> str:
    """The message as rostopic prints it: one `field: value` a line, nested by two spaces.

    Text was written by a peer: it stays on its line and cannot steer the terminal.
    """
    lines = []
    for field in field_names(message):
        value = getattr(message, field)
        head = " " * indent + f"{field}:"
        if hasattr(value, "__msgtype__"):
            lines += [head, render(value, indent + 2)]
        elif isinstance(value, list) and value and hasattr(value[0], "__msgtype__"):
            dash = " " * (indent + 2) + "-"
            lines += [head, *(f"{dash}\n{render(item, indent + 4)}" for item in value)]
        else:
            lines.append(f"{head} {_plain(value)}")
    return "\n".join(lines)


def _plain(value: Any) -> str:
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if isinstance(value, list):
        return "[" + ", ".join(_quoted(item) for item in value) + "]"
    return "\\n".join(map(printable, str(value).split("\n")))


def _quoted(item: object) -> str:
    return f"'{_plain(item)}'" if isinstance(item, str) else str(item)


def plain(value: Any) -> object:
    """A message, or a value in one, as what JSON has."""
    if hasattr(value, "__msgtype__"):
        return {field: plain(getattr(value, field)) for field in field_names(value)}
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    return [plain(item) for item in value] if isinstance(value, list) else value


def parse_message(text: str) -> object:
    """The YAML of a message, as in rostopic; see `grants.yamltext.load`.

    Raises:
        ConfigurationError: it is none, or more than is read.
    """
    try:
        return yamltext.load(text)
    except YamlRefused as error:
        shown = printable(text[:_SHOWN]) + ("..." if len(text) > _SHOWN else "")
        raise ConfigurationError(
            f"this is no YAML: {shown}: {error}", error.hint or "for example '{data: hello}'"
        ) from error
