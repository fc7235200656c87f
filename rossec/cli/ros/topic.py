"""`rossec topic`: publish and listen from the command line, with an identity."""

import asyncio
from typing import Any

import click

from ca.domains.aliases import local_name
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.message_text import fill, parse_message, render
from rossec.cli.shared.running import run_until_node_ends
from rossec.node import Node, Publisher
from rossec.participant.message_types import Message, message_type
from rossec.terminal import note, say


@click.command()
@click.argument("name")
@click.argument("type_name", metavar="TYPE")
@click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
@click.option("--count", "-n", type=click.IntRange(min=1), help="end after this many messages")
@pass_environment
def echo(environment: Environment, name: str, type_name: str, node: str, count: int | None) -> None:
    """Print the messages of the topic NAME, as NODE may see them."""
    asyncio.run(_echo(environment, name, type_name, node, count))


@click.command()
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
        subscriber = await running.subscriber(local_name(name), type_name)
        await run_until_node_ends(running, _print(subscriber, count))


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
        publisher = await running.publisher(local_name(name), type_name)
        note(f"waiting for a subscriber of {publisher.topic}")
        await run_until_node_ends(running, _publish(publisher, message, period, count))


async def _publish(
    publisher: Publisher, message: Message, period: float, count: int | None
) -> None:
    await publisher.wait_for_subscribers()
    sent = 0
    while count is None or sent < count:
        publisher.publish(message)
        sent += 1
        await asyncio.sleep(period)
