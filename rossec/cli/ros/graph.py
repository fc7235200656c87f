"""`rossec graph`: which nodes publish, subscribe and provide, now or as it changes."""

import asyncio
from collections import defaultdict
from typing import Final

import click

from ca.domains.aliases import is_alias, shown
from ca.errors import CertificateExpired, HintedError
from rossec.channel.edhoc.credentials import LiveCredentials
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import calls_as, master_at
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.participant.graph_view import METHOD, Fact, GraphView, ObservedChange
from rossec.participant.identity_renewal import IdentityRenewal, renew_identity
from rossec.terminal import note, printable, say, say_json

PAUSE: Final = 1.0  # seconds until the first reconnection
MAX_PAUSE: Final = 30.0  # seconds between later reconnections at most
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
    uri = master_at(environment, home)
    asyncio.run(
        _print_changes(environment, home, uri, as_json)
        if watch
        else _print_graph(environment, home, uri, as_json)
    )


async def _print_graph(environment: Environment, home: NodeHome, uri: str, as_json: bool) -> None:
    view = GraphView()
    async with calls_as(environment, home, uri) as call:
        while view.take(await call(METHOD, *view.next_params)).more:
            pass
    if as_json:
        say_json(_json(view, ObservedChange(tuple(sorted(view.facts)), (), False, False)))
        return
    for line in describe(view.facts):
        say(line)


async def _print_changes(environment: Environment, home: NodeHome, uri: str, as_json: bool) -> None:
    """Query graph changes until interrupted, reconnecting when needed.

    Raises:
        ConfigurationError: the identity has expired and was not renewed.
        HintedError, OSError: there was no answer at all.
    """
    view, pause, last_error = GraphView(), PAUSE, ""
    own = LiveCredentials(home.credentials())
    renewal = IdentityRenewal(home, own, now())
    while True:
        before = view.version
        try:
            async with calls_as(environment, home, uri, own.current) as call:
                while not await renew_identity(call, renewal, now()):
                    _print_change(view, view.take(await call(METHOD, *view.next_params)), as_json)
        except (HintedError, OSError, TimeoutError) as error:
            if view.version < 0:
                raise
            _check_identity(home)
            if before != view.version:
                pause, last_error = PAUSE, ""
            if str(error) != last_error:
                last_error = str(error)
                note(f"no graph changes received: {printable(last_error)}")
            await asyncio.sleep(pause)
            pause = min(2 * pause, MAX_PAUSE)


def _check_identity(home: NodeHome) -> None:
    """Stop when the identity has expired: no master accepts it any more."""
    try:
        home.identity(now())
    except CertificateExpired as error:
        raise ConfigurationError(f"{error}, and it was not renewed", error.hint) from error


def _print_change(view: GraphView, change: ObservedChange, as_json: bool) -> None:
    if change.restarted and not as_json:
        note("the master has restarted")
    if not (change.added or change.removed or change.restarted):
        return
    if as_json:
        say_json(_json(view, change))
        return
    for sign, facts in (("-", change.removed), ("+", change.added)):
        for fact in facts:
            say(f"{sign} {printable(' '.join(map(shown, fact)))}")


def _json(view: GraphView, change: ObservedChange) -> dict[str, object]:
    return {
        "instance": view.instance,
        "version": view.version,
        "restarted": change.restarted,
        "added": change.added,
        "removed": change.removed,
    }


def describe(facts: frozenset[Fact]) -> list[str]:
    """The graph as text: topics with their types and nodes, then services."""
    types = {name: value for kind, name, value in facts if kind == "type"}
    nodes: defaultdict[tuple[str, str], list[str]] = defaultdict(list)
    for kind, name, value in sorted(facts):
        nodes[kind, name].append(value)
    lines: list[str] = []
    for topic in sorted({name for kind, name, _ in facts if kind in _HEADINGS}, key=_own_first):
        lines.append(f"{shown(topic)} ({types[topic]})" if topic in types else shown(topic))
        lines += [
            f"  {heading} {', '.join(map(shown, nodes[kind, topic]))}"
            for kind, heading in _HEADINGS.items()
            if nodes[kind, topic]
        ]
    for name in sorted({name for kind, name in nodes if kind == "service"}, key=_own_first):
        lines.append(f"{shown(name)} provided by {', '.join(map(shown, nodes['service', name]))}")
    return [printable(line) for line in lines]


def _own_first(name: str) -> tuple[bool, str]:
    return is_alias(name), name
