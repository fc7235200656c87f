"""`rossec ca init`: create the authority of a trust domain."""

from pathlib import Path

import click

from ca.keys.hsm import KeyUri
from rossec.authority.home import AuthorityHome, fingerprint
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.terminal import say


@click.command()
@click.argument("domain")
@click.option(
    "--key", "uri", metavar="URI", help="make the key in a token: pkcs11:token=T;object=O"
)
@passphrase.option
@pass_environment
def init(
    environment: Environment, domain: str, uri: str | None, passphrase_file: Path | None
) -> None:
    """Create the authority of the trust domain DOMAIN, for example home.

    With --key its key is made in a PKCS#11 token and never leaves it; the passphrase is its PIN.
    """
    token = None if uri is None else KeyUri.parse(uri)
    if token is None:
        secret = passphrase.choose(passphrase_file, environment.variables)
    else:
        secret = passphrase.read(passphrase_file, environment.variables)
    home = AuthorityHome.create(environment.home, domain, secret, now(), token)
    say(f"authority of {domain} in {home.path}")
    say(f"fingerprint {fingerprint(home.anchor())}")
