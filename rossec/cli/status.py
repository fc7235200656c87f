"""`rossec master status | stop`, and the status of federation, gateway and relay, once or watched."""

import time
from collections.abc import Callable, Iterator
from typing import Any, Final

import click

from ca.names import display_name
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, pass_environment
from rossec.cli.sites import RELAY_SOCKET, relay_files
from rossec.environment import missing_node, own_gateway, own_master
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.master.operation import send_command
from rossec.terminal import note, printable, say, say_json

PERIOD: Final = 1.0  # seconds between two questions
watch = options.flag("--watch", "show it again whenever it changes, until Ctrl-C")
Answer = dict[str, Any]
ADMIN_SOCKET: Final = "admin.sock"


@click.command()
@options.flag("--json as_json", "a line of JSON")
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
@options.json_result(pass_environment)
def stop_master(environment: Environment) -> None:
    """Stop the running master in order; it must have been started with --admin."""
    send_command(_home(environment).path / ADMIN_SOCKET, "stop")
    say("the master ends", stopping=True)


@click.command()
@options.flag("--json as_json", "a line of JSON")
@watch
@pass_environment
def federation_status(environment: Environment, *, as_json: bool, watch: bool) -> None:
    """Show how far each master is followed; the own one must have been started with --admin."""
    home = NodeHome.of(environment.home, own_master(environment.variables))
    show_status(
        lambda: send_command(home.path / ADMIN_SOCKET, "federation"),
        _federation_lines,
        lambda answer: (
            "" if _federation_lines(answer) else "no master is followed: rossec federation add URI --as LABEL"
        ),
        as_json=as_json,
        watch=watch,
        changing=_without_figures,
    )


def _federation_lines(answer: Answer) -> list[str]:
    lines = [line for site in answer["sites"] for line in _site_lines(site)]
    return [*lines, *(f"{where}: {what}" for where, what in answer["problems"].items())]


def _site_lines(site: dict[str, Any]) -> Iterator[str]:
    # 1. what is known of it
    name = display_name(str(site["domain"]), str(site["master"]))
    lost = "" if site["lost_s"] is None else " (its names are shown for a minute)"
    error = f"  {site['error']}" if site["error"] else ""
    mirrored = f", {site['mirrored']} parameters" if site.get("mirrored") else ""
    where = f"via {site['via']}" if site.get("via") else f"at {site['uri']}"
    yield (
        f"{site['label']:<16} {site['state']:<10} {site['facts']} facts{mirrored}{lost}"
        f"  {name} {where}, by {site['source']}{error}"
    )
    if hint := site.get("hint", ""):
        yield f"{'':<16} hint: {hint}"
    # 2. the way to it, if a relay carries it
    if site.get("via"):
        if way := site.get("way"):
            relays = f"by {way['relay']} and {way['router']}" if way["router"] else f"by {way['relay']}"
            rtt = f"round trip {way['rtt_ms']:.1f} ms, " if way["rtt_ms"] else ""
            figures = f"{way['retransmissions']} retransmissions, {way['streams']} connections"
            yield f"{'':<16} {relays}, {way['state']}, {rtt}{figures}"
        else:
            yield f"{'':<16} no relay of this site knows {site['via']}"
    # 3. its topics, or the first of them
    if topics := site.get("topics", [])[:8]:  # topics of a site; with --json a thousand
        more = site["topics_count"] - len(topics)
        yield f"{'':<16} topics: {' '.join(topics)}" + f" and {more} more" * bool(more)


def _without_figures(answer: Answer) -> list[str]:
    still = {"rtt_ms": 0, "retransmissions": 0, "streams": 0}
    sites = [
        {**site, "way": {**site["way"], **still}} if site.get("way") else site for site in answer["sites"]
    ]
    return _federation_lines({**answer, "sites": sites})


@click.command()
@options.as_json
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
        lambda answer: (
            ""
            if answer["topics"]
            else "nothing is served: is a topic of these patterns published there, and shown?"
        ),
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
    changing: Callable[[Answer], list[str]] | None = None,
) -> None:
    """Ask and print, once or until Ctrl-C; `missing` is said of an answer that lacks something.

    It is printed again when `changing` is another, by default the lines.
    """
    shown: list[str] | None = None
    while True:
        answer = ask()
        if as_json:
            say_json(answer)
        elif (found := (changing or lines)(answer)) != shown:
            shown = found
            for line in lines(answer):
                say(printable(line))
            if said := missing(answer):
                note(said)
        if not watch:
            return
        time.sleep(PERIOD)


def _gateway_lines(answer: Answer) -> list[str]:
    problem = f": the graph cannot be followed: {answer['problem']}" * bool(answer["problem"])
    lines = [f"{answer['gateway']}{problem}"]
    for rule in answer["rules"]:
        rate = f", {rule['rate']:g} messages a second" if rule["rate"] is not None else ""
        newest = ", the newest only" * rule["newest"]
        compress = ", compressed" * rule["compress"]
        lines.append(f"  from {rule['from']}: {rule['pattern']}{rate}{newest}{compress}")
    for row in answer["topics"]:
        lines.append(
            f"{row['topic']} ({row['type']}) as {row['served']}  {row['state']},"
            f" {row['subscribers']} here, {row['publishers']} there,"
            f" {row['messages']} messages, {row['octets']} bytes"
        )
        lines += [f"  {row['problem']}"] if row["problem"] else []
    for row in answer["skipped"]:
        lines.append(f"{row['topic']} is not served: {row['why']}")
        lines += [f"  hint: {row['hint']}"] if row["hint"] else []
    if left := answer["skipped_count"] - len(answer["skipped"]):
        lines.append(f"and {left} more are not served")
    return lines


@click.command()
@options.as_json
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
        lambda answer: (
            "" if answer["peers"] else "no relay of another site is known: rossec relay descriptor LABEL"
        ),
        as_json=as_json,
        watch=watch,
    )


def _relay_lines(answer: Answer) -> list[str]:
    router = answer["router"] or "no router is in reach"
    head = f"{answer['relay']} of {answer['domain']}, account {answer['account']} at {router}"
    lines = [f"{head}, {answer['forwarded_ports']} forwarded ports"]
    lines += [f"{name}: {why or 'polled for forwarded ports'}" for name, why in answer["masters"].items()]
    for peer in answer["peers"]:
        speed = f"  {peer['rtt_ms']} ms, {peer['retransmissions']} retransmissions" if peer["rtt_ms"] else ""
        called = f", {peer['called']} links from it" if peer["called"] else ""
        error = f"  {peer['error']}" if peer["error"] else ""
        lines.append(
            f"{peer['label']:<16} {peer['state']:<10} {peer['relay']}"
            f"  {peer['streams']} connections{called}{speed}{error}"
        )
        lines += [f"{'':<16} hint: {peer['hint']}"] if peer["hint"] else []
    return [*lines, answer["problem"]] if answer["problem"] else lines
