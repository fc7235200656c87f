"""`rossec topic`: publish and listen from the command line, with an identity."""

import asyncio
from collections.abc import AsyncIterable, AsyncIterator, Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Final

import click

from ca.domains.aliases import local_name
from rossec import files
from rossec.cli.ros.claimed_types import readable
from rossec.cli.ros.listening import Arrivals, listening, watched
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as
from rossec.cli.shared.message_output import plain, render
from rossec.cli.shared.message_text import (
    fill,
    mentions_now,
    parse_arguments,
    parse_documents,
    stamp_now,
)
from rossec.cli.shared.running import run_until_node_ends
from rossec.cli.shared.system_state import as_node
from rossec.errors import ConfigurationError, MessageError
from rossec.node import Publisher
from rossec.participant.message_types import Message, MessageType, message_type
from rossec.terminal import note, say, say_block, say_json

Show = Callable[[Message], None]
MAX_FILE: Final = 4 * 1024 * 1024  # as much YAML as is read


@click.command()
@click.argument("name")
@click.argument("type_name", metavar="[TYPE]", required=False)
@as_node
@click.option("--count", "-n", type=click.IntRange(min=1), help="end after this many messages")
@click.option("--noarr", is_flag=True, help="without lists, which may be long")
@click.option("--nostr", is_flag=True, help="without text")
@click.option("--json", "as_json", is_flag=True, help="a line of JSON for each message, with all")
@pass_environment
def echo(
    environment: Environment,
    name: str,
    type_name: str | None,
    node: str,
    count: int | None,
    noarr: bool,
    nostr: bool,
    as_json: bool,
) -> None:
    """Print the messages of the topic NAME, as NODE may see them.

    With TYPE only messages of this type are received.
    """
    if as_json and (noarr or nostr):
        raise click.UsageError("--json has all fields: leave --noarr and --nostr")
    hidden = tuple(kind for kind, hide in ((list, noarr), (str, nostr)) if hide)
    show = _as_json if as_json else partial(_as_text, hidden=hidden)
    asyncio.run(
        _echo_any(environment, name, node, count, show) if type_name is None
        else _echo(environment, name, type_name, node, count, show)
    )  # fmt: skip


@click.command()
@click.argument("name")
@click.argument("type_name", metavar="TYPE")
@click.argument("content", nargs=-1)
@as_node
@click.option(
    "--rate", "-r",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    show_default=True,
    help="messages per second",
)  # fmt: skip
@click.option("--count", "-n", type=click.IntRange(min=1), help="end after this many messages")
@click.option("--once", "-1", is_flag=True, help="publish one message and end")
@click.option(
    "--file", "-f", "file", type=options.FILE,
    help="the messages in FILE in turn, each behind a line ---, as `rossec topic echo` prints them",
)  # fmt: skip
@pass_environment
def pub(
    environment: Environment,
    name: str,
    type_name: str,
    content: tuple[str, ...],
    node: str,
    rate: float,
    count: int | None,
    once: bool,
    file: Path | None,
) -> None:
    """Publish CONTENT (YAML, as in rostopic) on the topic NAME.

    CONTENT is one mapping of fields, or a value for each field in order; `now` is the time of each
    message, `auto` a header with it. Before a CONTENT that begins with - write --.
    """
    contents = _contents(content, file)
    messages = Messages(message_type(type_name), contents)
    ends = 1 if once else len(contents) if file is not None and count is None else count
    asyncio.run(_pub(environment, name, messages, node, 1 / rate, ends))


def _as_text(message: Message, hidden: tuple[type, ...]) -> None:
    say_block(render(message, hidden=hidden))
    say("---")


def _as_json(message: Message) -> None:
    say_json(plain(message))


async def _echo_any(
    environment: Environment, name: str, node: str, count: int | None, show: Show
) -> None:
    async with listening(environment, name, node) as (running, arrivals):
        await run_until_node_ends(running, _print(_read(arrivals), count, show))


async def _read(arrivals: Arrivals) -> AsyncIterator[Message]:
    """Messages by the types that publishers claim; what cannot be read is said, and left out."""
    async for source, data in arrivals.messages():
        try:
            yield readable(source.type).deserialize(data)
        except MessageError as error:
            arrivals.refused(error)


async def _echo(
    environment: Environment, name: str, type_name: str, node: str, count: int | None, show: Show
) -> None:
    async with node_as(environment, node) as running:
        subscriber = await running.subscriber(local_name(name), type_name)
        async with watched(subscriber):
            await run_until_node_ends(running, _print(subscriber, count, show))


async def _print(messages: AsyncIterable[Message], count: int | None, show: Show) -> None:
    seen = 0
    async for message in messages:
        show(message)
        seen += 1
        if seen == count:
            return


class Messages:
    """The messages of a command line, in turn and again; what says `now` is made each time anew."""

    def __init__(self, kind: MessageType, contents: Sequence[object]) -> None:
        """`contents` is not empty; raises ConfigurationError where one does not fit the type."""
        self.kind = kind
        self._contents = contents
        self._made = [self._make(content) for content in contents]

    def at(self, number: int) -> Message:
        """The message that is sent as number `number`, from 0."""
        place = number % len(self._contents)
        content = self._contents[place]
        return self._make(content) if mentions_now(content) else self._made[place]

    def _make(self, content: object) -> Message:
        message = self.kind.create()
        fill(message, content, stamp_now())
        return message


def _contents(content: tuple[str, ...], file: Path | None) -> list[object]:
    if file is None:
        return [parse_arguments(content)]
    if content:
        raise click.UsageError("CONTENT and --file exclude each other")
    text = files.read(file, MAX_FILE).decode(errors="replace")
    contents = parse_documents(text)
    if not contents:
        raise ConfigurationError(f"{file} holds no message", "one or more, with --- between them")
    return contents


async def _pub(
    environment: Environment,
    name: str,
    messages: Messages,
    node: str,
    period: float,
    count: int | None,
) -> None:
    async with node_as(environment, node) as running:
        publisher = await running.publisher(local_name(name), messages.kind.name)
        note(f"waiting for a subscriber of {publisher.topic}")
        await run_until_node_ends(running, _publish(publisher, messages, period, count))


async def _publish(
    publisher: Publisher, messages: Messages, period: float, count: int | None
) -> None:
    await publisher.wait_for_subscribers()
    sent = 0
    while count is None or sent < count:
        publisher.publish(messages.at(sent))
        sent += 1
        await asyncio.sleep(period)
