"""`rossec ca intermediate`: a host that signs nodes for a limited time, below an offline root."""

from pathlib import Path

import click

from ca.authority import DAY, MAX_LIFETIME
from ca.intermediates import check_intermediate_request
from ca.keys.publickey import thumbprint
from rossec import files
from rossec.authority import intermediate_home
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.renewals import sign_intermediate
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import (
    Duration,
    Environment,
    confirm,
    format_time,
    now,
    pass_environment,
)
from rossec.cli.shared.delivery import remind_to_publish
from rossec.errors import ConfigurationError
from rossec.terminal import say

_MAX_FILE = 16 * 1024
_FILE = click.Path(path_type=Path, exists=True, dir_okay=False)


@click.command()
@click.argument("domain")
@passphrase.option
@pass_environment
def request(environment: Environment, domain: str, passphrase_file: Path | None) -> None:
    """On the host: make its key and a request, to carry to the root of DOMAIN."""
    secret = passphrase.choose(passphrase_file, environment.variables)
    path = intermediate_home.begin(environment.home, domain, secret)
    key = check_intermediate_request(path.read_bytes(), domain)
    say(f"request of an intermediate of {domain}: {path}")
    say(f"fingerprint {format_fingerprint(thumbprint(key))}")
    say(f"next, at the root: rossec ca intermediate sign {path} --may renew")


@click.command()
@click.argument("request", type=_FILE)
@click.option(
    "--may", required=True, type=click.Choice(["renew", "enroll"]),
    help="renew identities that exist, or enroll new nodes as well",
)  # fmt: skip
@click.option(
    "--for", "lifetime", type=Duration(MAX_LIFETIME // DAY), default="90d", show_default=True,
    help="how long it may sign",
)  # fmt: skip
@click.option("--yes", is_flag=True, help="do not ask")
@passphrase.option
@pass_environment
def sign(
    environment: Environment,
    request: Path,
    may: str,
    lifetime: int,
    yes: bool,
    passphrase_file: Path | None,
) -> None:
    """At the root: sign REQUEST of a host, and set what it may do."""
    home = AuthorityHome.at(environment.home)
    data = files.read(request, _MAX_FILE, ConfigurationError(f"there is no {request}"))
    key = check_intermediate_request(data, home.domain)
    powers = "renew identities" + (" and enroll new nodes" if may == "enroll" else "")
    say(f"an intermediate of {home.domain} that may {powers} until {format_time(now() + lifetime)}")
    say(f"  fingerprint {format_fingerprint(thumbprint(key))}")
    confirm("is this the fingerprint its host shows, and sign it?", yes=yes)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    number = authority.store.next_number()
    name, bundle = sign_intermediate(
        authority, data, now(), may_enroll=may == "enroll", lifetime=lifetime
    )
    target = request.with_suffix(".pem")
    files.replace(target, bundle, 0o644)
    say(f"signed {name}: {target}")
    say(f"to revoke it, with all it signed: rossec ca revoke {name}")
    remind_to_publish(authority.store, number)


@click.command()
@click.argument("bundle", type=_FILE)
@passphrase.option
@pass_environment
def install(environment: Environment, bundle: Path, passphrase_file: Path | None) -> None:
    """On the host: install BUNDLE, which the root signed."""
    data = files.read(bundle, _MAX_FILE, ConfigurationError(f"there is no {bundle}"))
    secret = passphrase.read(passphrase_file, environment.variables)
    found = intermediate_home.install(environment.home, data, secret, now())
    powers = "renew and enroll" if found.may_enroll else "renew"
    say(f"this host may {powers} until {format_time(found.not_after)}")
