"""`rossec console phone | phones | approvals`: which phones can approve, and what was approved with them."""

import time
from contextlib import closing
from typing import Any
from urllib.parse import quote, urlsplit

import click

from ca.approvals.passkeys import Passkey
from ca.approvals.statement import StatementKind
from ca.enrollment import qr
from ca.store.log import ApprovalState
from rossec.authority.console.messages import CODE_LIFETIME, sentence
from rossec.authority.home import AuthorityHome
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.clock import format_time
from rossec.console.listening import read_address
from rossec.console.options import LOCALHOST, MAX_PHONE_NAME
from rossec.errors import ConfigurationError
from rossec.terminal import printable, say, say_json, say_picture


@click.command()
@options.option("--name", "what the phone will be called; it can be changed there", default="")
@options.flag("--no-wait", "do not wait until the phone is set up")
@options.flag("--json as_json", "one line of JSON; does not wait")
@pass_environment
def phone(environment: Environment, name: str, no_wait: bool, as_json: bool) -> None:
    """Show a one-time code that logs in a phone, and can set it up to approve.

    Scan it with the phone, or open the address. It works once, within 2 minutes, either to look or
    to set up the phone. Waits until a phone is set up; Ctrl-C ends the waiting, not the code.
    """
    if len(name) > MAX_PHONE_NAME or (name and not name.isprintable()):
        raise ConfigurationError(
            f"a phone's name is one line of at most {MAX_PHONE_NAME} characters", "shorten it"
        )
    home = AuthorityHome.at(environment.home)
    with closing(running_service(home)) as client:
        origin = read_address(home.path)
        known = _phones(home)
        address = login_address(origin, client.phone_code(), name)
    if as_json:
        say_json({"login": address, "seconds": int(CODE_LIFETIME)})
        return
    show_code(address)
    if not no_wait:
        end = time.monotonic() + CODE_LIFETIME
        while time.monotonic() < end:
            for number, called in _phones(home).items():
                if number not in known:
                    say(f"{printable(called)} is set up")
                    return
            time.sleep(0.5)  # seconds between two looks at the record
        say("the code is over, and set up no phone")


def running_service(home: AuthorityHome) -> KeyServiceClient:
    client = KeyServiceClient.find(home.path)
    if client is None:
        raise ConfigurationError(
            "the authority's service does not run", "start it in another terminal: rossec ca serve"
        )
    return client


def _phones(home: AuthorityHome) -> dict[bytes, str]:
    with closing(home.store()) as store:
        return {passkey.id: passkey.name for passkey in store.passkeys.active()}


def login_address(origin: str, code: str, name: str = "") -> str:
    """The address that logs in with a code; in the fragment, which browsers send to nobody."""
    return f"{origin}/login#{code}" + (f".{quote(name, safe='')}" if name else "")


def show_code(address: str) -> None:
    say_picture(qr.terminal(address))
    say(address)
    if urlsplit(address).hostname == LOCALHOST:
        say("for a browser of this computer; for a phone see: rossec console --help, --lan")
    say("works once, within 2 minutes; another one: rossec console phone")


@click.command()
@click.argument("name")
@options.reason
@options.json_result(pass_environment)
def remove(environment: Environment, name: str, reason: str) -> None:
    """Let the phone NAME approve nothing any more, also not what still waits for the key."""
    with closing(AuthorityHome.at(environment.home).store()) as store:
        found = [each for each in store.passkeys.active() if each.name == name]
        if not found:
            raise ConfigurationError(f"no phone is called {name!a}", "see: rossec console phones")
        # What it approved and still waits for the key ends with it (attack `console-removed-phone`).
        before = len(store.approvals.waiting())
        store.remove_passkey(found[0].id, reason, now())
        ended = before - len(store.approvals.waiting())
    say(f"{printable(name)} can approve nothing any more", name=name, ended=ended)
    if ended:
        say(f"what it approved and was not done yet comes to nothing: {ended}")


@click.command()
@options.flag("--verify", "recompute every signature, with the whole log")
@options.as_json
@pass_environment
def approvals(environment: Environment, verify: bool, as_json: bool) -> None:
    """Show who approved what at the console, oldest first, and what came of it.

    With --verify: each was signed by a phone that was set up then, for exactly what was done; exit
    code 1 and the number of the first wrong entry of the log, if not.
    """
    home = AuthorityHome.at(environment.home)
    with closing(home.store()) as store:
        if verify:
            store.log.audit(home.own_key())
        phones = {passkey.id: passkey.name for passkey in store.passkeys.all()}
        found, ends = store.approvals.all(), store.approvals.ends()
    rows: list[dict[str, Any]] = [
        {
            "id": each.id.hex(),
            "kind": StatementKind(each.kind).name.lower().replace("_", "-"),
            "what": sentence(each.read(), each.payload),
            "phone": phones.get(each.passkey, "?"),
            "at": each.at,
            "state": ends[each.id].state if each.id in ends else str(ApprovalState.WAITING),
            "result": ends[each.id].result if each.id in ends else "",
            "statement": each.read().challenge.hex(),
            **({"verified": True} if verify else {}),
        }
        for each in found
    ]
    lines = [
        printable(
            f"{row['id'][:8]}  {format_time(row['at'])}  {row['phone']}  {row['what']}: {row['state']}"
            + (f" ({row['result']})" if row["result"] else "")
        )
        for row in rows
    ]
    if verify:
        lines.append(f"{len(found)} approval{'s' * (len(found) != 1)}, each signed by its phone")
    options.say_result(as_json, rows, lines or ["nothing was approved at the console yet"])


def show(environment: Environment, *, everything: bool, as_json: bool) -> None:
    with closing(AuthorityHome.at(environment.home).store()) as store:
        found = store.passkeys.all() if everything else store.passkeys.active()
        ended = store.passkeys.ended()
        used = {each.passkey: each.at for each in store.approvals.all()}
    lines = []
    for each in found:
        at = used.get(each.id)
        last = f"approved last {format_time(at)}" if at else "has approved nothing"
        end = f"  removed: {ended[each.id]}" if each.id in ended else ""
        lines.append(printable(f"{each.name}  since {format_time(each.at)}  {last}  {each.origin}{end}"))
    rows = [_summary(each, used, ended) for each in found]
    options.say_result(as_json, rows, lines or ["no phone can approve; next: rossec console phone"])


def _summary(passkey: Passkey, used: dict[bytes, int], ended: dict[bytes, str]) -> dict[str, object]:
    return {
        "id": passkey.id.hex(),
        "name": passkey.name,
        "since": passkey.at,
        "approved_last": used.get(passkey.id),
        "origin": passkey.origin,
        "added_by": passkey.approval.hex(),
        "ended": ended.get(passkey.id),
    }
