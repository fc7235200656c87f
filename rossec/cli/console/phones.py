"""`rossec console phones`: which phones can approve, and how one is removed at the terminal."""

from contextlib import closing

import click

from ca.approvals.assertion import Passkey
from ca.store.record import Store
from rossec.authority.home import AuthorityHome
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import printable, record, say, say_json


def show(environment: Environment, *, everything: bool, as_json: bool) -> None:
    """Show the phones that can approve, or every one there was."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        found = store.passkeys.all() if everything else store.passkeys.active()
        ended, used = store.passkeys.ended(), _last_used(store)
    if as_json:
        say_json([_summary(each, used, ended) for each in found])
        return
    for each in found:
        at = used.get(each.id)
        last = f"approved last {format_time(at)}" if at else "has approved nothing"
        end = f"  removed: {ended[each.id]}" if each.id in ended else ""
        say(printable(f"{each.name}  since {format_time(each.at)}  {last}  {each.origin}{end}"))
    if not found:
        say("no phone can approve; next: rossec console phone")


@click.command()
@click.argument("name")
@click.option("--reason", default="", help="why, for the record")
@json_result()
@pass_environment
def remove(environment: Environment, name: str, reason: str) -> None:
    """Let the phone NAME approve nothing any more, also not what still waits for the key."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        found = [each for each in store.passkeys.active() if each.name == name]
        if not found:
            raise ConfigurationError(f"no phone is called {name!a}", "see: rossec console phones")
        before = len(store.approvals.waiting())
        store.remove_passkey(found[0].id, reason, now())
        ended = before - len(store.approvals.waiting())
    record(name=name, ended=ended)
    say(f"{printable(name)} can approve nothing any more")
    if ended:
        say(f"what it approved and was not done yet comes to nothing: {ended}")


def _last_used(store: Store) -> dict[bytes, int]:
    """When each passkey approved something last."""
    return {each.passkey: each.at for each in store.approvals.all()}


def _summary(
    passkey: Passkey, used: dict[bytes, int], ended: dict[bytes, str]
) -> dict[str, object]:
    return {
        "id": passkey.id.hex(),
        "name": passkey.name,
        "since": passkey.at,
        "approved_last": used.get(passkey.id),
        "origin": passkey.origin,
        "added_by": passkey.approval.hex(),
        "ended": ended.get(passkey.id),
    }
