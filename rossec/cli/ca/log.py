"""`rossec ca log`: what the authority did, whether the log is complete, and proofs for others."""

import base64
from pathlib import Path
from typing import Any

import click

from ca.store.log_entries import LogEntry, leaf, open_head
from rossec import files
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.busy import working
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, remind_to_publish
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import note, printable, record, say, say_json

_MAX_HEAD = 4096


def show(environment: Environment, last: int | None, *, in_json: bool) -> None:
    """Show the newest `last` entries, by default all."""
    entries = AuthorityHome.at(environment.home).store().log.entries()[-(last or 0) :]
    if in_json:
        say_json([_as_json(entry) for entry in entries])
        return
    for entry in entries:
        words = [str(entry.number), format_time(entry.at), entry.what, entry.subject, entry.detail]
        say(printable("  ".join(filter(None, words))))


@click.command()
@click.option(
    "--head", "heads", multiple=True, type=options.FILE,
    help="a signed head kept elsewhere (rossec ca log head)",
)  # fmt: skip
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@pass_environment
def verify(environment: Environment, heads: tuple[Path, ...], in_json: bool) -> None:
    """Recompute the whole log and compare it with the record and with every signed head.

    Exit code 1 and the number of the first wrong entry, if anything is not as it was written.
    """
    home = AuthorityHome.at(environment.home)
    store = home.store()
    kept = [files.read(path, _MAX_HEAD) for path in heads]
    with working("recomputing the log", quiet=in_json):
        newest = store.log.audit(home.own_key(), *kept)
    size = store.log.head(now()).size
    if in_json:
        say_json({"entries": size, "signed": newest.size, "at": newest.issued})
        return
    say(f"{size} entries, all as they were written")
    if newest.size:
        say(f"the first {newest.size} are signed, {format_time(newest.issued)}")
    else:
        say("none of them is signed: next, rossec ca log head")
    if not heads:
        note("a head kept elsewhere proves more: the owner of this file could rewrite all of it")


@click.command()
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="write it here")
@json_result()
@pass_service
def head(service: AuthorityService, out: Path | None) -> None:
    """Sign the state of the log, to be kept elsewhere."""
    data = service.sign_head()
    remind_to_publish(service)
    size = open_head(data, service.home.own_key()).size
    record(entries=size, head=base64.b64encode(data).decode())
    if out is None:
        say(base64.b64encode(data).decode())
        return
    files.replace(out, data, 0o644)
    record(file=str(out))
    say(f"head of {size} entries: {out}")


@click.command()
@click.option("--entry", type=click.IntRange(0), help="prove that this entry is in the log")
@click.option(
    "--since", type=options.FILE,
    help="prove that the log continues this signed head",
)  # fmt: skip
@pass_environment
def prove(environment: Environment, entry: int | None, since: Path | None) -> None:
    """Print a proof, as JSON, against the newest signed head (RFC 6962)."""
    home = AuthorityHome.at(environment.home)
    if (entry is None) == (since is None):
        raise ConfigurationError("there is nothing to prove, or too much", "--entry N or --since F")
    journal = home.store().log
    heads = journal.heads()
    if not heads:
        raise ConfigurationError("no state of the log was signed yet", "next: rossec ca log head")
    signed = heads[-1]
    newest, tree = open_head(signed, home.own_key()), journal.tree()
    shown: dict[str, Any] = {"size": newest.size, "root": newest.root.hex()}
    if entry is not None:
        content = leaf(journal.entries()[entry]) if entry < len(tree) else b""
        shown |= {"entry": entry, "leaf": content.hex()}
        proof = tree.inclusion(entry, newest.size)
    else:
        old = open_head(files.read(since or Path(), _MAX_HEAD), home.own_key())
        shown |= {"first": old.size, "first_root": old.root.hex()}
        proof = tree.consistency(old.size, newest.size)
    head_text = base64.b64encode(signed).decode()
    say_json({**shown, "proof": [digest.hex() for digest in proof], "head": head_text})


def _as_json(entry: LogEntry) -> dict[str, Any]:
    return {**entry._asdict(), "digest": entry.digest.hex()}
