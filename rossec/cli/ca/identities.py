"""`rossec ca list | show | renew`: the identities of the authority, and their renewal."""

from pathlib import Path
from typing import Any

import click

from ca.authority import DAY, MAX_LIFETIME
from ca.errors import HintedError
from ca.renewal import renew_at
from ca.store.record import Store
from ca.store.rows import CertificateRow
from rossec import files, terminal
from rossec.authority import thing_records as things
from rossec.authority.home import AuthorityHome, fingerprint, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.authority.signing import OWN_NODE
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Duration, Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, remind_to_publish
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import note, record, say, say_json

_ITS = "its machine", "their machines"


def states(store: Store, at: int) -> list[tuple[CertificateRow, str]]:
    """Every identity with what it is now: valid, replaced by a newer one, expired, or revoked."""
    with store.database.read_transaction():
        rows, revoked = store.identities.all(), store.revoked_entries()
        in_force = store.identities.with_valid_issuer(rows)
    valid = {row.serial for row in in_force if row.thumbprint not in revoked}
    newest = {row.name: row.serial for row in rows if row.serial in valid}
    return [(row, _state(row, at, newest, row.serial not in valid)) for row in rows]


def _state(row: CertificateRow, at: int, newest: dict[str, int], revoked: bool) -> str:
    if revoked:
        return "revoked"
    if at > row.not_after:
        return "expired"
    return "valid" if newest[row.name] == row.serial else "replaced"


def as_json(row: CertificateRow, state: str) -> dict[str, Any]:
    """One identity as JSON."""
    return {
        "name": row.name,
        "state": state,
        "anonymous": row.wildcard,
        "not_before": row.not_before,
        "expires": row.not_after,
        "ends_soon": state == "valid" and ends_soon(row, now()),
        "key": row.thumbprint.hex(),
        "serial": f"{row.serial:x}",
    }


def ends_soon(row: CertificateRow, at: int) -> bool:
    """Whether it should have been renewed by now."""
    return at >= renew_at(row.not_before, row.not_after)


def line(row: CertificateRow, state: str) -> str:
    """One identity as a line of text."""
    name = f"{row.name} and {row.name}_*" if row.wildcard else row.name
    until, key = (
        f"until {format_time(row.not_after)}",
        f"fingerprint {format_fingerprint(row.thumbprint)}",
    )
    return "  ".join([name, until, key, *[terminal.state(state)] * (state != "valid")])


@click.command("list")
@click.option("--all", "everything", is_flag=True, help="also what is replaced, expired or revoked")
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@pass_environment
def list_(environment: Environment, everything: bool, in_json: bool) -> None:
    """List the identities that are valid now."""
    found = states(AuthorityHome.at(environment.home).store(), now())
    chosen = [(row, state) for row, state in found if everything or state == "valid"]
    if in_json:
        say_json([as_json(row, state) for row, state in chosen])
        return
    for row, state in chosen:
        say(line(row, state))
    for text in _remarks(found, now()):
        note(text)


def _remarks(found: list[tuple[CertificateRow, str]], at: int) -> list[str]:
    """What is to be done: identities that end soon and were not renewed, and those that are over.

    Of a name only the newest identity counts: an older one was renewed, or another key replaced it.
    """
    newest = {row.name: (row, state) for row, state in found}.values()
    soon = [row.name for row, state in newest if state == "valid" and ends_soon(row, at)]
    over = [row.name for row, state in newest if state == "expired"]
    remarks = []
    if soon:
        remarks.append(
            f"not renewed yet, with less than a third of their time left: {', '.join(soon)}"
            " (rossec ca serve renews nodes that run; others: rossec ca renew NAME)"
        )
    if over:
        remarks.append(
            f"over: {', '.join(over)} (with key and grants back by: rossec ca renew --expired NAME)"
        )
    return remarks


@click.command()
@click.argument("name", required=False)
@click.option("--json", "in_json", is_flag=True, help="one line of JSON")
@pass_environment
def show(environment: Environment, name: str | None, in_json: bool) -> None:
    """Show the authority, or everything about the node NAME."""
    home = AuthorityHome.at(environment.home)
    with_states = [
        (row, state) for row, state in states(home.store(), now()) if name in {None, row.name}
    ]
    if name is not None and not with_states:
        raise ConfigurationError(f"{name} never had an identity here", "see: rossec ca list --all")
    if in_json:
        identities = [as_json(row, state) for row, state in with_states]
        about = {"domain": home.domain, "fingerprint": fingerprint(home.anchor())}
        say_json({**about, "intermediate": home.is_intermediate, "identities": identities})
        return
    say(f"authority of {home.domain} in {home.path}")
    say(f"fingerprint {fingerprint(home.anchor())}")
    for row, state in with_states:
        say(line(row, state))
    for each in things.states(home.store(), now()) if name is not None else ():
        if name in {each.row.name, each.row.border} and each.state == things.IN_FORCE:
            say(
                f"thing {each.row.name} at {each.row.border}, until {format_time(each.row.expires)}"
            )


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@click.option(
    "--for", "lifetime", type=Duration(MAX_LIFETIME // DAY), default="30d", show_default=True,
    help="how long the new identity lasts",
)  # fmt: skip
@click.option(
    "--expired", is_flag=True, help="also one that is over: it keeps its key, and so its grants"
)
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="where to write it")
@json_result()
@pass_service
def renew(
    service: AuthorityService,
    names: tuple[str, ...],
    lifetime: int,
    expired: bool,
    out: Path | None,
) -> None:
    """Renew the identity of NAME for the key it has; /ca is the authority's own node.

    Nodes that run are renewed by `rossec ca serve`; this is for others. The new identity is written
    to a file to install on the node; where its directory is below this ROSSEC_HOME, and that of
    /ca, it is installed at once. What is revoked never comes back. Where one of several is refused
    the others are renewed, and the exit code is 1.
    """
    names = unique(names)
    if out is not None and len(names) > 1:
        raise click.UsageError("--out is of one NAME")
    if len(names) > 1:
        service.unlock()  # a wrong passphrase is no fault of a name
    batch, carried = Batch(len(names), "name"), list[Path]()
    for name in names:
        with batch.item(name):
            if name == OWN_NODE:
                expires = service.renew_own_node()
                record(expires=expires)
                say(f"renewed {name} until {format_time(expires)}")
            else:
                target = _renew(service, name, lifetime, out, expired=expired)
                carried += [] if _install(service, name, target) else [target]
    if carried:
        listed = " ".join(map(str, carried))
        say(f"next, on {_ITS[len(carried) > 1]}: rossec node install {listed}")
    remind_to_publish(service)
    batch.finish()


def _renew(
    service: AuthorityService, name: str, lifetime: int, out: Path | None, *, expired: bool
) -> Path:
    bundle = service.renew(name, lifetime, expired=expired)
    target = out or Path(f"{name.lstrip('/').replace('/', '.')}.pem")
    files.replace(target, bundle, 0o644)
    record(file=str(target))
    say(f"renewed {name}: {target}")
    return target


def _install(service: AuthorityService, name: str, bundle: Path) -> bool:
    """Install it where the node's directory is here; returns whether it is."""
    home = NodeHome.of(service.rossec_home, name)
    if not (home.path / "node.pem").exists():
        return False
    try:
        home.install(bundle.read_bytes(), now())
    except (HintedError, OSError) as error:  # of another key, or of another user
        note(f"not installed in {home.path}: {error}")
        return False
    record(installed=str(home.path))
    say(f"installed in {home.path}")
    return True
