"""`rossec domain list | show`: which domains are trusted, and how far."""

from contextlib import closing

import click

from ca.store.record import Store
from ca.store.signed_statements import DomainRow
from rossec.authority.domain_operations import find_row, living_grants
from rossec.authority.home import AuthorityHome
from rossec.cli.domain import trust
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.options import flag, say_result
from rossec.clock import format_time
from rossec.terminal import printable, say, say_json


@click.command("list")
@flag("--all everything", "also those that were removed")
@flag("--json in_json", "one line of JSON")
@pass_environment
def list_(environment: Environment, everything: bool, in_json: bool) -> None:
    """List the foreign domains that are trusted."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        rows = store.domains.accepted()
        if everything:
            rows = list({(row.label, row.root): row for row in store.domains.all()}.values())
        states = [(row, _state(store, row)) for row in rows]
    none = "no foreign domains" if everything else "no foreign domain is trusted"
    lines = [
        printable(f"{row.label}  {row.domain}  until {format_time(row.read().until)}  {state}")
        for row, state in states
    ]
    document = [{**trust.as_json(row.read()), "state": state} for row, state in states]
    say_result(in_json, document, lines or [none])


@click.command()
@click.argument("label")
@flag("--json in_json", "one line of JSON")
@pass_environment
def show(environment: Environment, label: str, in_json: bool) -> None:
    """Show how far the domain LABEL is trusted."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        row = find_row(store, label)
        held, state = row.read(), _state(store, row)
        grants = len(living_grants(store, label, now()))
        reason, ended = store.domains.ends().get(row.number, ("", 0))
    if in_json:
        shown = {**trust.as_json(held), "state": state, "grants": grants}
        say_json({**shown, "since": row.at, "ended": ended or None, "reason": reason})
        return
    say(printable(f"domain {row.domain}, here {label}: {state}"))
    for line in trust.lines(held):
        say(printable(line))
    say(f"  {grants} grants for its nodes are in force or can be renewed")
    say(f"  these terms since {format_time(row.at)}")
    if ended:
        say(printable(f"  removed {format_time(ended)}{f': {reason}' * bool(reason)}"))
    else:
        say("  whether it trusts this domain too, the master knows: rossec federation status")


def _state(store: Store, row: DomainRow) -> str:
    if row.number not in {each.number for each in store.domains.accepted()}:
        return "removed"
    return "trusted" if now() < row.read().until else "its time is over"
