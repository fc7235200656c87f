"""`rossec ca import`: record at the root the identities that intermediates have signed."""

from pathlib import Path

import click

from ca.certificates import Identity, from_pem
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.renewals import import_identity
from rossec.cli.shared import options, passphrase, signing_options
from rossec.cli.shared.batch import Batch
from rossec.cli.shared.context import Environment, confirm, format_time, now, pass_environment
from rossec.cli.shared.delivery import publish_list, remind_to_publish
from rossec.errors import ConfigurationError
from rossec.terminal import say

_MAX_BUNDLE = 64 * 1024


@click.command("import")
@click.argument(
    "bundles",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
)
@signing_options.replace_key(multiple=True)
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@passphrase.option
@pass_environment
def import_(
    environment: Environment,
    bundles: tuple[Path, ...],
    replaced: tuple[str, ...],
    master_uri: str | None,
    yes: bool,
    passphrase_file: Path | None,
) -> None:
    """Record the identities in BUNDLES (node.pem), which an intermediate enrolled or renewed.

    Only then can the root sign grants for these nodes, or revoke them by their names.
    """
    home, batch = AuthorityHome.at(environment.home), Batch(len(bundles))
    found: list[tuple[Path, bytes]] = []
    for path in bundles:
        with batch.item(path):
            data = files.read(path, _MAX_BUNDLE, ConfigurationError(f"there is no {path}"))
            _show_identity(home, path, home.anchor().verify(from_pem(data)[:-1], now()))
            found.append((path, data))
    if found:
        confirm(f"import {len(found)} of them?", yes=yes)
        _import(environment, home, batch, found, replaced, master_uri, passphrase_file)
    batch.finish()


def _import(
    environment: Environment,
    home: AuthorityHome,
    batch: Batch,
    found: list[tuple[Path, bytes]],
    replaced: tuple[str, ...],
    master_uri: str | None,
    passphrase_file: Path | None,
) -> None:
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    number, revoked = authority.store.next_number(), authority.store.revoked_entries()
    for path, data in found:
        with batch.item(path):
            identity, new = import_identity(authority, data, now(), replaced)
            say(f"{'imported' if new else 'known already:'} {identity.name}")
    if authority.store.revoked_entries() == revoked:
        remind_to_publish(authority.store, number)
        return
    say("the replaced key is revoked")
    publish_list(environment, master_uri)


def _show_identity(home: AuthorityHome, path: Path, identity: Identity) -> None:
    say(f"{identity.name} of {home.domain} until {format_time(identity.not_after)} ({path})")
    say(f"  fingerprint {format_fingerprint(identity.thumbprint)}")
    for issuer in identity.issuers:
        say(f"  signed by intermediate/{issuer.hex()[:16]}")
