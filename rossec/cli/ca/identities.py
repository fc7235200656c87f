"""`rossec ca list | show | renew`: the identities of the authority, and their renewal."""

from pathlib import Path
from typing import Any

import click

from ca.authority import DAY, MAX_LIFETIME
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
from rossec.terminal import record, say, say_json

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
        "key": row.thumbprint.hex(),
        "serial": f"{row.serial:x}",
    }


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
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="where to write it")
@json_result()
@pass_service
def renew(
    service: AuthorityService, names: tuple[str, ...], lifetime: int, out: Path | None
) -> None:
    """Renew the identity of NAME for the key it has; /ca is the authority's own node.

    The new one is written to a file to install on the node; that of /ca is installed here. Where
    one of several is refused the others are renewed, and the exit code is 1.
    """
    names = unique(names)
    if out is not None and len(names) > 1:
        raise click.UsageError("--out is of one NAME")
    if len(names) > 1:
        service.unlock()  # a wrong passphrase is no fault of a name
    batch, written = Batch(len(names), "name"), list[Path]()
    for name in names:
        with batch.item(name):
            if name == OWN_NODE:
                expires = service.renew_own_node()
                record(expires=expires)
                say(f"renewed {name} until {format_time(expires)}")
            else:
                written.append(_renew(service, name, lifetime, out))
    if written:
        listed = " ".join(map(str, written))
        say(f"next, on {_ITS[len(written) > 1]}: rossec node install {listed}")
    remind_to_publish(service)
    batch.finish()


def _renew(service: AuthorityService, name: str, lifetime: int, out: Path | None) -> Path:
    bundle = service.renew(name, lifetime)
    target = out or Path(f"{name.lstrip('/').replace('/', '.')}.pem")
    files.replace(target, bundle, 0o644)
    record(file=str(target))
    say(f"renewed {name}: {target}")
    return target
