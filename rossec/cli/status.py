"""`rossec master status | stop`, and the status of federation, gateway and relay, once or watched."""

import time
from collections.abc import Callable
from typing import Any, Final

import click

from ca.names import display_name
from rossec.cli.relay.sites import RELAY_SOCKET, relay_files
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.shared.options import json_result
from rossec.environment import missing_node, own_gateway, own_master
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master.operation.admin import send_command
from rossec.terminal import note, printable, record, say, say_json

PERIOD: Final = 1.0  # seconds between two questions
as_json = click.option("--json", "as_json", is_flag=True, help="one line of JSON")
watch = click.option("--watch", is_flag=True, help="show it again whenever it changes, until Ctrl-C")
Answer = dict[str, Any]
ADMIN_SOCKET: Final = "admin.sock"
_PERIOD: Final = 1.0
_SHOWN: Final = 8  # topics of a site; with --json a thousand


@click.command()
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@pass_environment
def master_status(environment: Environment, as_json: bool) -> None:
    """Show the status of the running master; it must have been started with --admin."""
    answer = send_command(_home(environment).path / ADMIN_SOCKET, "status")
    if as_json:
        say_json(answer)
        return
    for key, value in answer.items():
        say(f"{key.replace('_', ' '):<20} {printable(str(value))}")


def _home(environment: Environment) -> NodeHome:
    home = NodeHome.of(environment.home, own_master(environment.variables))
    if not home.path.is_dir():  # it cannot run from here: the terminal lacks ROSSEC_HOME, perhaps
        hint = missing_node(environment.home, home.name)
        raise ConfigurationError(f"there is no {home.name} in {environment.home}", hint)
    return home


@click.command()
@json_result()
@pass_environment
def stop_master(environment: Environment) -> None:
    """Stop the running master in order; it must have been started with --admin."""
    send_command(_home(environment).path / ADMIN_SOCKET, "stop")
    record(stopping=True)
    say("the master ends")


@click.command()
@click.option("--json", "as_json", is_flag=True, help="a line of JSON")
@click.option("--watch", is_flag=True, help="show it again whenever it changes, until Ctrl-C")
@pass_environment
def federation_status(environment: Environment, *, as_json: bool, watch: bool) -> None:
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
        line for site in answer["sites"] for line in (_line(site), *_hint(site), *_way(site), *_topics(site))
    ]
    return [*sites, *(printable(f"{where}: {what}") for where, what in answer["problems"].items())]


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


def _hint(site: dict[str, Any]) -> list[str]:
    hint = str(site.get("hint", ""))  # a running master may be of an older version
    return [printable(f"{'':<16} hint: {hint}")] if hint else []


def _way(site: dict[str, Any]) -> list[str]:
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
    topics = site.get("topics", [])
    if not topics:
        return []
    more = site["topics_count"] - len(topics[:_SHOWN])
    others = f" and {more} more" if more else ""
    return [printable(f"{'':<16} topics: {' '.join(topics[:_SHOWN])}{others}")]


def _without_figures(answer: dict[str, Any]) -> list[str]:
    still = {"rtt_ms": 0, "retransmissions": 0, "streams": 0}
    sites = [
        {**site, "way": {**site["way"], **still}} if site.get("way") else site for site in answer["sites"]
    ]
    return _lines({**answer, "sites": sites})


@click.command()
@as_json
@watch
@pass_environment
def gateway_status(environment: Environment, *, as_json: bool, watch: bool) -> None:
    """Show what the running gateway serves, and what not.

    How many here are subscribed to each topic, how many publishers of it are connected at its
    origin, what was forwarded, and why a topic that it should serve is not served.
    """
    home = NodeHome.of(environment.home, own_gateway(environment.variables))
    show_status(
        lambda: send_command(home.path / ADMIN_SOCKET, "status", "gateway"),
        _gateway_lines,
        _missing,
        as_json=as_json,
        watch=watch,
    )


def show_status(
    ask: Callable[[], Answer],
    lines: Callable[[Answer], list[str]],
    missing: Callable[[Answer], str],
    *,
    as_json: bool,
    watch: bool,
) -> None:
    """Ask and print, once or until Ctrl-C; `missing` is said of an answer that lacks something."""
    shown: list[str] | None = None
    while True:
        answer = ask()
        if as_json:
            say_json(answer)
        elif (found := lines(answer)) != shown:
            shown = found
            for line in found:
                say(printable(line))
            if said := missing(answer):
                note(said)
        if not watch:
            return
        time.sleep(PERIOD)


def _gateway_lines(answer: dict[str, Any]) -> list[str]:
    problem = f": the graph cannot be followed: {answer['problem']}" * bool(answer["problem"])
    rules = [_rule(each) for each in answer["rules"]]
    topics = [line for each in answer["topics"] for line in _topic(each)]
    skipped = [line for each in answer["skipped"] for line in _skipped(each)]
    left = answer["skipped_count"] - len(answer["skipped"])
    more = [f"and {left} more are not served"] if left else []
    return [f"{answer['gateway']}{problem}", *rules, *topics, *skipped, *more]


def _rule(rule: dict[str, Any]) -> str:
    rate = f", {rule['rate']:g} messages a second" if rule["rate"] is not None else ""
    newest = ", the newest only" if rule["newest"] else ""
    compress = ", compressed" if rule["compress"] else ""
    return f"  from {rule['from']}: {rule['pattern']}{rate}{newest}{compress}"


def _topic(row: dict[str, Any]) -> list[str]:
    line = (
        f"{row['topic']} ({row['type']}) as {row['served']}  {row['state']},"
        f" {row['subscribers']} here, {row['publishers']} there,"
        f" {row['messages']} messages, {row['octets']} bytes"
    )
    return [line, *([f"  {row['problem']}"] if row["problem"] else [])]


def _skipped(row: dict[str, Any]) -> list[str]:
    hint = [f"  hint: {row['hint']}"] if row["hint"] else []
    return [f"{row['topic']} is not served: {row['why']}", *hint]


def _missing(answer: dict[str, Any]) -> str:
    if answer["topics"]:
        return ""
    return "nothing is served: is a topic of these patterns published there, and shown?"


@click.command()
@as_json
@watch
@pass_environment
def relay_status(environment: Environment, *, as_json: bool, watch: bool) -> None:
    """Show the links of the running relay.

    To whom they are, how fast, what had to be sent again, and how many connections they carry.
    """
    socket = relay_files(environment).home.path / RELAY_SOCKET
    show_status(
        lambda: send_command(socket, "status", "relay"),
        _relay_lines,
        _status_missing,
        as_json=as_json,
        watch=watch,
    )


def _relay_lines(answer: dict[str, Any]) -> list[str]:
    router = answer["router"] or "no router is in reach"
    head = f"{answer['relay']} of {answer['domain']}, seat {answer['seat']} at {router}"
    masters = [f"{name}: {why or 'polled for doors'}" for name, why in answer["masters"].items()]
    peers = [line for peer in answer["peers"] for line in _peer(peer)]
    problem = [answer["problem"]] if answer["problem"] else []
    return [f"{head}, {answer['doors']} doors", *masters, *peers, *problem]


def _peer(peer: dict[str, Any]) -> list[str]:
    speed = f"  {peer['rtt_ms']} ms, {peer['retransmissions']} retransmissions"
    called = f", {peer['called']} links from it" if peer["called"] else ""
    error = f"  {peer['error']}" if peer["error"] else ""
    line = (
        f"{peer['label']:<16} {peer['state']:<10} {peer['relay']}"
        f"  {peer['streams']} connections{called}{speed if peer['rtt_ms'] else ''}{error}"
    )
    return [line, *([f"{'':<16} hint: {peer['hint']}"] if peer["hint"] else [])]


def _status_missing(answer: dict[str, Any]) -> str:
    return "" if answer["peers"] else "no relay of another site is known: rossec relay card LABEL"
