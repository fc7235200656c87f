"""`rossec ca init`: create the authority of a trust domain."""

from contextlib import closing
from pathlib import Path

import click

from ca.keys.private_keys import KeyUri
from rossec.authority.home import AuthorityHome, check_new, enroll_here, fingerprint
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.options import flag, json_result, option
from rossec.clock import format_time
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from rossec.terminal import record, say


@click.command()
@click.argument("domain")
@option("--key=URI uri", "make the key in a token: pkcs11:token=T;object=O")
@flag("--master with_master", "enroll /master here too")
@passphrase.option
@json_result(pass_environment)
def init(
    environment: Environment, domain: str, uri: str | None, with_master: bool, passphrase_file: Path | None
) -> None:
    """Create the authority of the trust domain DOMAIN, for example home.

    With --master this host can run its master at once. With --key its key is made in a PKCS#11
    token and never leaves it; the passphrase is its PIN.
    """
    token = None if uri is None else KeyUri.parse(uri)
    master = NodeHome.of(environment.home, MASTER)
    # All that may be refused, before a passphrase is asked for twice and a key is made.
    AuthorityHome.check_new(environment.home)
    if with_master:
        check_new(master)
    if token is None:
        secret = passphrase.choose(passphrase_file, environment.variables)
    else:
        secret = passphrase.read(passphrase_file, environment.variables)
    home = AuthorityHome.create(environment.home, domain, secret, now(), token)
    found = fingerprint(home.anchor())
    say(f"authority of {domain} in {home.path}", domain=domain, path=str(home.path), fingerprint=found)
    say(f"fingerprint {found}")
    if with_master:
        authority = home.unlock(secret)
        with closing(authority.store):
            expires = enroll_here(authority, master, now())
        record(master=str(master.path), expires=expires)
        say(f"/master in {master.path}, until {format_time(expires)}; start it with: rossec master")
