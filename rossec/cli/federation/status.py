"""`rossec federation status`: how far each site is followed, from the running master."""

import time
from typing import Any, Final

import click

from ca.domains.aliases import display_name
from rossec.cli.master.admin import ADMIN_SOCKET
from rossec.cli.shared.context import Environment, pass_environment
from rossec.environment import own_master
from rossec.home import NodeHome
from rossec.master.operation.admin import send_command
from rossec.terminal import note, printable, say, say_json

_PERIOD: Final = 1.0
_SHOWN: Final = 8  # topics of a site; with --json a thousand


@click.command()
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@click.option("--watch", is_flag=True, help="show it again whenever it changes, until Ctrl-C")
@pass_environment
def status(environment: Environment, *, as_json: bool, watch: bool) -> None:
    """Show how far each master is followed; the own one must have been started with --admin."""
    home = NodeHome.of(environment.home, own_master(environment.variables))
    shown: object = None
    while True:
        answer = send_command(home.path / ADMIN_SOCKET, "federation")
        lines = [] if as_json else _lines(answer)
        if as_json:
            say_json(answer)
        elif _without_figures(answer) != shown:
            for line in lines:
                say(line)
            if not lines:
                note("no master is followed: rossec federation add URI --as LABEL")
        shown = _without_figures(answer)
        if not watch:
            return
        time.sleep(_PERIOD)


def _lines(answer: dict[str, Any]) -> list[str]:
    sites = [
        line
        for site in answer["sites"]
        for line in (_line(site), *_hint(site), *_way(site), *_topics(site))
    ]
    return [*sites, *(printable(f"{where}: {what}") for where, what in answer["problems"].items())]


def _without_figures(answer: dict[str, Any]) -> list[str]:
    """The lines, but for what changes all the time."""
    still = {"rtt_ms": 0, "retransmissions": 0, "streams": 0}
    sites = [
        {**site, "way": {**site["way"], **still}} if site.get("way") else site
        for site in answer["sites"]
    ]
    return _lines({**answer, "sites": sites})


def _hint(site: dict[str, Any]) -> list[str]:
    hint = str(site.get("hint", ""))  # a running master may be of an older version
    return [printable(f"{'':<16} hint: {hint}")] if hint else []


def _way(site: dict[str, Any]) -> list[str]:
    """How the site is reached, if by a relay; an older master has none."""
    if not site.get("via"):
        return []
    way = site.get("way")
    if not way:
        return [printable(f"{'':<16} no relay of this site knows {site['via']}")]
    parts = [f"by {way['relay']} and {way['router']}" if way["router"] else f"by {way['relay']}"]
    parts.append(str(way["state"]))
    if way["rtt_ms"]:
        parts.append(f"round trip {way['rtt_ms']:.1f} ms")
    parts.append(f"{way['retransmissions']} retransmissions, {way['streams']} connections")
    return [printable(f"{'':<16} {', '.join(parts)}")]


def _topics(site: dict[str, Any]) -> list[str]:
    """The topics that go this way."""
    topics = site.get("topics", [])
    if not topics:
        return []
    more = site["topics_count"] - len(topics[:_SHOWN])
    others = f" and {more} more" if more else ""
    return [printable(f"{'':<16} topics: {' '.join(topics[:_SHOWN])}{others}")]


def _line(site: dict[str, Any]) -> str:
    name = display_name(str(site["domain"]), str(site["master"]))
    lost = "" if site["lost_s"] is None else " (its names are shown for a minute)"
    error = f"  {site['error']}" if site["error"] else ""
    mirrored = f", {site['mirrored']} parameters" if site.get("mirrored") else ""
    where = f"via {site['via']}" if site.get("via") else f"at {site['uri']}"
    return printable(
        f"{site['label']:<16} {site['state']:<10} {site['facts']} facts{mirrored}{lost}"
        f"  {name} {where}, by {site['source']}{error}"
    )
