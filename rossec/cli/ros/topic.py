"""`rossec topic pub | echo | hz | bw`: publish and listen as a node that runs for one command."""

import asyncio
import time
from collections import deque
from collections.abc import AsyncIterable, AsyncIterator, Callable, Coroutine, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import click

from ca.names import local_name, shown
from rossec import files
from rossec.cli.ros.graph import as_node
from rossec.cli.shared import messages as texts
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.master import node_as
from rossec.cli.shared.options import FILE, flag, option
from rossec.errors import ConfigurationError, MessageError
from rossec.host.runner import until_first_ends
from rossec.node import Node, Publisher
from rossec.node.subscriber import RawSource, Subscriber
from rossec.participant.definitions import Definition
from rossec.participant.message_types import Message, MessageType, message_type, register_types
from rossec.terminal import note, printable, say, say_block, say_json

MOMENT: Final = 2.0  # seconds in which a publisher that runs is connected
KEPT: Final = 100  # messages that wait; older ones are dropped, as a subscriber's queue does
Arrived = tuple[RawSource, bytes]
Show = Callable[[Message], None]
MAX_FILE: Final = 4 * 1024 * 1024  # as much YAML as is read
PERIOD: Final = 1.0  # seconds between two lines
_WINDOW = option("--window -w=N", "of the last N messages only", type=click.IntRange(min=2))
_COUNT = option("--count -n", "end after N lines", type=click.IntRange(min=1))
Add = Callable[[float, int], None]


@click.command()
@click.argument("name")
@click.argument("type_name", metavar="[TYPE]", required=False)
@as_node
@option("--count -n", "end after this many messages", type=click.IntRange(min=1))
@flag("--noarr", "without lists, which may be long")
@flag("--nostr", "without text")
@flag("--json as_json", "a line of JSON for each message, with all")
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

    def show(message: Message) -> None:
        if as_json:
            say_json(texts.plain(message))
            return
        say_block(texts.render(message, hidden=hidden))
        say("---")

    async def listen() -> None:
        if type_name is None:
            async with listening(environment, name, node) as (running, arrivals):
                await run_until_node_ends(running, _print(_read(arrivals), count, show))
            return
        async with node_as(environment, node) as running:
            subscriber = await running.subscriber(local_name(name), type_name)
            async with watched(subscriber):
                await run_until_node_ends(running, _print(subscriber, count, show))

    asyncio.run(listen())


class Arrivals:
    def __init__(self, size: int = KEPT) -> None:
        self._queue: deque[Arrived] = deque(maxlen=size)
        self._wake = asyncio.Event()
        self._said: set[str] = set()

    def connected(self, _: RawSource) -> None: ...

    def received(self, source: RawSource, messages: Sequence[bytes]) -> None:
        self._queue.extend((source, bytes(message)) for message in messages)
        self._wake.set()

    def disconnected(self, _: RawSource) -> None: ...

    def refused(self, error: Exception) -> None:
        # Say once why a publisher is not connected, or no longer.
        hint = getattr(error, "hint", "")
        text = printable(f"{error}" + (f"; {hint}" if hint else ""))
        if text not in self._said:
            self._said.add(text)
            note(text)

    async def messages(self) -> AsyncIterator[Arrived]:
        while True:
            while self._queue:
                yield self._queue.popleft()
            self._wake.clear()
            await self._wake.wait()


@asynccontextmanager
async def listening(environment: Environment, name: str, node: str) -> AsyncIterator[tuple[Node, Arrivals]]:
    async with node_as(environment, node) as running:
        arrivals = Arrivals()
        topic = running.settings.resolve(local_name(name))
        subscriber = await running.topics.subscribe_raw(topic, arrivals)
        async with watched(subscriber):
            yield running, arrivals


@asynccontextmanager
async def watched(subscriber: Subscriber) -> AsyncIterator[None]:
    async def say_if_nobody() -> None:
        await asyncio.sleep(MOMENT)
        if not subscriber.publishers:
            note(f"nobody publishes {shown(subscriber.topic)} at this master; waiting")

    task = asyncio.ensure_future(say_if_nobody())
    try:
        yield
    finally:
        task.cancel()
        await asyncio.gather(task, return_exceptions=True)


async def run_until_node_ends(node: Node, work: Coroutine[Any, Any, None]) -> None:
    """Run `work`; if the node ends first, cancel it and raise why the node ended.

    Both tasks have ended when this returns, also after Ctrl-C: the node is closed next.
    """
    await until_first_ends(node.wait_ended(), work)


async def _print(messages: AsyncIterable[Message], count: int | None, show: Show) -> None:
    seen = 0
    async for message in messages:
        show(message)
        seen += 1
        if seen == count:
            return


async def _read(arrivals: Arrivals) -> AsyncIterator[Message]:
    # Messages by the types that publishers claim; what cannot be read is said, and left out.
    async for source, data in arrivals.messages():
        try:
            yield readable(source.type).deserialize(data)
        except MessageError as error:
            arrivals.refused(error)


def readable(claimed: Definition) -> MessageType:
    """The type to read messages of `claimed` by: nothing is decided by what a publisher claims."""
    # Its grammar is checked before the library generates code of it (attack `definition-runs-code`).
    try:
        known = message_type(claimed.name)
    except MessageError:
        register_types({claimed.name: claimed.definition})
        known = message_type(claimed.name)
    # Nothing is decided by what a publisher claims: by another definition its bytes would mean other fields.
    if known.md5sum != claimed.md5sum:
        raise MessageError(
            f"the publisher's {claimed.name} is another one than here",
            "its messages cannot be read by the definition that is installed here",
        )
    return known


@click.command()
@click.argument("name")
@click.argument("type_name", metavar="TYPE")
@click.argument("content", nargs=-1)
@as_node
@option(
    "--rate -r",
    "messages per second",
    type=click.FloatRange(min=0, min_open=True),
    default=1.0,
    show_default=True,
)
@option("--count -n", "end after this many messages", type=click.IntRange(min=1))
@flag("--once -1", "publish one message and end")
@option(
    "--file -f file",
    "the messages in FILE in turn, each behind a line ---, as `rossec topic echo` prints them",
    type=FILE,
)
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

    async def work() -> None:
        async with node_as(environment, node) as running:
            publisher = await running.publisher(local_name(name), messages.kind.name)
            note(f"waiting for a subscriber of {publisher.topic}")
            await run_until_node_ends(running, _publish(publisher, messages, 1 / rate, ends))

    asyncio.run(work())


def _contents(content: tuple[str, ...], file: Path | None) -> list[object]:
    if file is None:
        return [texts.parse_arguments(content)]
    if content:
        raise click.UsageError("CONTENT and --file exclude each other")
    text = files.read(file, MAX_FILE).decode(errors="replace")
    contents = texts.parse_documents(text)
    if not contents:
        raise ConfigurationError(f"{file} holds no message", "one or more, with --- between them")
    return contents


class Messages:
    def __init__(self, kind: MessageType, contents: Sequence[object]) -> None:
        # `contents` is not empty; raises ConfigurationError where one does not fit the type.
        self.kind = kind
        self._contents = contents
        self._made = [self._make(content) for content in contents]

    def at(self, number: int) -> Message:
        place = number % len(self._contents)
        content = self._contents[place]
        return self._make(content) if texts.mentions_now(content) else self._made[place]

    def _make(self, content: object) -> Message:
        message = self.kind.create()
        texts.fill(message, content, texts.stamp_now())
        return message


async def _publish(publisher: Publisher, messages: Messages, period: float, count: int | None) -> None:
    await publisher.wait_for_subscribers()
    sent = 0
    while count is None or sent < count:
        publisher.publish(messages.at(sent))
        sent += 1
        await asyncio.sleep(period)


@click.command()
@click.argument("name")
@as_node
@_WINDOW
@_COUNT
@pass_environment
def hz(environment: Environment, name: str, node: str, window: int | None, count: int | None) -> None:
    """Show how often messages of the topic NAME arrive, as NODE may see them."""
    rates = texts.RateWindow(window)
    _watch(environment, name, node, lambda now, _: rates.add(now), rates.describe, count)


def _watch(
    environment: Environment, name: str, node: str, add: Add, describe: Callable[[], str], count: int | None
) -> None:
    async def watch() -> None:
        async with listening(environment, name, node) as (running, arrivals):
            note(f"subscribed to [{name}]")

            async def count_all() -> None:
                async for _, data in arrivals.messages():
                    add(time.monotonic(), len(data))

            async def say_all() -> None:
                lines = 0
                while count is None or lines < count:
                    await asyncio.sleep(PERIOD)
                    say_block(describe())
                    lines += 1

            await run_until_node_ends(running, until_first_ends(count_all(), say_all()))

    asyncio.run(watch())


@click.command()
@click.argument("name")
@as_node
@_WINDOW
@_COUNT
@pass_environment
def bw(environment: Environment, name: str, node: str, window: int | None, count: int | None) -> None:
    """Show how many bytes of the topic NAME arrive, as NODE may see them."""
    sizes = texts.SizeWindow(window or 100)  # rostopic's

    _watch(environment, name, node, sizes.add, lambda: sizes.describe(time.monotonic()), count)
