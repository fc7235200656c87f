"""`rossec graph`: who publishes, subscribes and provides, now or as it changes."""

import asyncio
from collections import defaultdict
from typing import Final

import click

from ca.errors import HintedError
from rossec.cli.context import Environment, pass_environment
from rossec.cli.reach import master_as, master_at
from rossec.cli.voice import note, printable, say, say_json
from rossec.home import NodeHome
from rossec.node.graph import METHOD, Change, Fact, GraphView

_PAUSE: Final = 1.0  # seconds until a master that is gone is looked for again
_HEADINGS: Final = {"publisher": "published by", "subscriber": "subscribed by"}


@click.command()
@click.option("--as", "node", required=True, metavar="NODE", help="identity to use")
@click.option("--watch", is_flag=True, help="go on, and say what changes; ends with Ctrl-C")
@click.option("--json", "as_json", is_flag=True, help="a line of JSON for each answer")
@pass_environment
def graph(environment: Environment, node: str, watch: bool, as_json: bool) -> None:
    """Show the graph, as far as NODE may see it.

    NODE needs the right graph on /master: rossec grant sign NODE --graph
    """
    home = NodeHome.of(environment.home, node)
    uri = master_at(environment)
    asyncio.run(
        _follow(environment, home, uri, as_json)
        if watch
        else _look(environment, home, uri, as_json)
    )


async def _look(environment: Environment, home: NodeHome, uri: str, as_json: bool) -> None:
    view = GraphView()
    await _listen(environment, home, uri, view, once=True)
    if as_json:
        say_json(_json(view, Change(tuple(sorted(view.facts)), (), False, False)))
        return
    for line in describe(view.facts):
        say(line)


async def _follow(environment: Environment, home: NodeHome, uri: str, as_json: bool) -> None:
    view = GraphView()
    while True:
        try:
            await _listen(environment, home, uri, view, as_json=as_json)
        except (HintedError, OSError, TimeoutError) as error:
            if view.version < 0:
                raise
            note(f"no news of the graph: {printable(str(error))}")
            await asyncio.sleep(_PAUSE)


async def _listen(
    environment: Environment,
    home: NodeHome,
    uri: str,
    view: GraphView,
    *,
    as_json: bool = False,
    once: bool = False,
) -> None:
    """Ask for news until the connection ends; with `once`, until all is told."""
    async with master_as(environment, home, uri) as client:
        await client.ask("rossec.presentGrants", home.name, home.grants())
        while True:
            change = view.take(await client.ask(METHOD, home.name, *view.question))
            if not once:
                _say(view, change, as_json)
            elif not change.more:
                return


def _say(view: GraphView, change: Change, as_json: bool) -> None:
    if change.restarted and not as_json:
        note("the master has begun anew")
    if not (change.added or change.removed or change.restarted):
        return
    if as_json:
        say_json(_json(view, change))
        return
    for sign, facts in (("-", change.removed), ("+", change.added)):
        for fact in facts:
            say(f"{sign} {printable(' '.join(fact))}")


def _json(view: GraphView, change: Change) -> dict[str, object]:
    return {
        "instance": view.instance,
        "version": view.version,
        "restarted": change.restarted,
        "added": change.added,
        "removed": change.removed,
    }


def describe(facts: frozenset[Fact]) -> list[str]:
    """The graph for people: topics with their types and nodes, then services."""
    types = {name: value for kind, name, value in facts if kind == "type"}
    people: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for kind, name, value in sorted(facts):
        people[kind, name].append(value)
    lines: list[str] = []
    for topic in sorted({name for kind, name, _ in facts if kind in _HEADINGS}):
        lines.append(f"{topic} ({types[topic]})" if topic in types else topic)
        lines += [
            f"  {heading} {', '.join(people[kind, topic])}"
            for kind, heading in _HEADINGS.items()
            if people[kind, topic]
        ]
    for kind, name in sorted(people):
        if kind == "service":
            lines.append(f"{name} provided by {', '.join(people[kind, name])}")
    return [printable(line) for line in lines]
