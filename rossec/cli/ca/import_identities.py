"""`rossec ca import`: record at the root the identities that intermediates have signed."""

from pathlib import Path

import click

from ca.certificates import Identity, from_pem
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options, signing_options
from rossec.cli.shared.batch import Batch
from rossec.cli.shared.context import confirm, now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_if_revoked
from rossec.clock import format_time
from rossec.terminal import record, say

_MAX_BUNDLE = 64 * 1024


@click.command("import")
@click.argument("bundles", nargs=-1, required=True, type=options.FILE)
@signing_options.replace_key(multiple=True)
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@json_result()
@pass_service
def import_(
    service: AuthorityService, bundles: tuple[Path, ...], replaced: tuple[str, ...], yes: bool
) -> None:
    """Record the identities in BUNDLES (node.pem), which an intermediate enrolled or renewed.

    Only then can the root sign grants for these nodes, or revoke them by their names.
    """
    home, batch = service.home, Batch(len(bundles))
    found: list[tuple[Path, bytes]] = []
    for path in bundles:
        with batch.item(path, last=False):
            data = files.read(path, _MAX_BUNDLE)
            _show_identity(home, path, home.anchor().verify(from_pem(data)[:-1], now()))
            found.append((path, data))
    if found:
        confirm(f"import {len(found)} of them?", yes=yes)
        service.unlock()
        for path, data in found:
            with batch.item(path):
                identity, new = service.import_identity(data, replaced)
                record(name=identity.name, new=new)
                say(f"{'imported' if new else 'known already:'} {identity.name}")
        publish_if_revoked(service)
    batch.finish()


def _show_identity(home: AuthorityHome, path: Path, identity: Identity) -> None:
    say(f"{identity.name} of {home.domain} until {format_time(identity.not_after)} ({path})")
    say(f"  fingerprint {format_fingerprint(identity.thumbprint)}")
    for issuer in identity.issuers:
        say(f"  signed by intermediate/{issuer.hex()[:16]}")
