"""`rossec border credential`: what things know their border router by."""

from pathlib import Path

import click

from rossec import files
from rossec.authority.home import format_fingerprint
from rossec.cli.border.things import as_border
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_things import ThingFiles
from rossec.terminal import record, say


@click.command()
@click.argument("file", type=click.Path(path_type=Path, dir_okay=False))
@as_border
@json_result()
@pass_environment
def credential(environment: Environment, file: Path, router: str) -> None:
    """Write the router's credential for its things to FILE: they know it by this key.

    It is a CCS (RFC 9528), as CBOR, and no secret; but a thing that is given another one serves
    another router.
    """
    try:
        from rossec.border.handshakes import StaticKey  # noqa: PLC0415 - an extra
    except ImportError:
        raise ConfigurationError(
            "EDHOC for things is not installed", "pip install 'rossec[constrained]'"
        ) from None
    home = NodeHome.of(environment.home, router)
    home.identity(now())
    found = StaticKey(ThingFiles(home).router_key()).credential
    files.replace(file, found.ccs, 0o644)
    record(name=router, key=found.thumbprint.hex(), file=str(file))
    say(f"credential of {router}: fingerprint {format_fingerprint(found.thumbprint)}: {file}")
