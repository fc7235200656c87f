"""`rossec ca intermediate`: a host that signs nodes for a limited time, below an offline root."""

from pathlib import Path

import click

from ca.authority import DAY, MAX_LIFETIME
from ca.intermediates import check_intermediate_request
from ca.keys.publickey import thumbprint
from rossec import files
from rossec.authority import intermediate_home
from rossec.authority.home import format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Duration, Environment, confirm, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, remind_to_publish
from rossec.clock import format_time
from rossec.terminal import record, say

_MAX_FILE = 16 * 1024


@click.command()
@click.argument("domain")
@passphrase.option
@json_result()
@pass_environment
def request(environment: Environment, domain: str, passphrase_file: Path | None) -> None:
    """On the host: make its key and a request, to carry to the root of DOMAIN."""
    secret = passphrase.choose(passphrase_file, environment.variables)
    path = intermediate_home.begin(environment.home, domain, secret)
    key = check_intermediate_request(path.read_bytes(), domain)
    record(domain=domain, file=str(path), key=thumbprint(key).hex())
    say(f"request of an intermediate of {domain}: {path}")
    say(f"fingerprint {format_fingerprint(thumbprint(key))}")
    say(f"next, at the root: rossec ca intermediate sign {path} --may renew")


@click.command()
@click.argument("request", type=options.FILE)
@click.option(
    "--may", required=True, type=click.Choice(["renew", "enroll"]),
    help="renew identities that exist, or enroll new nodes as well",
)  # fmt: skip
@click.option(
    "--for", "lifetime", type=Duration(MAX_LIFETIME // DAY), default="90d", show_default=True,
    help="how long it may sign",
)  # fmt: skip
@click.option("--yes", is_flag=True, help="do not ask")
@json_result()
@pass_service
def sign(service: AuthorityService, request: Path, may: str, lifetime: int, yes: bool) -> None:
    """At the root: sign REQUEST of a host, and set what it may do."""
    domain = service.home.domain
    data = files.read(request, _MAX_FILE)
    key = check_intermediate_request(data, domain)
    powers = "renew identities" + (" and enroll new nodes" if may == "enroll" else "")
    say(f"an intermediate of {domain} that may {powers} until {format_time(now() + lifetime)}")
    say(f"  fingerprint {format_fingerprint(thumbprint(key))}")
    confirm("is this the fingerprint its host shows, and sign it?", yes=yes)
    name, bundle = service.sign_intermediate(data, may_enroll=may == "enroll", lifetime=lifetime)
    target = request.with_suffix(".pem")
    files.replace(target, bundle, 0o644)
    record(name=name, file=str(target), key=thumbprint(key).hex(), may=may)
    say(f"signed {name}: {target}")
    say(f"to revoke it, with all it signed: rossec ca revoke {name}")
    remind_to_publish(service)


@click.command()
@click.argument("bundle", type=options.FILE)
@passphrase.option
@json_result()
@pass_environment
def install(environment: Environment, bundle: Path, passphrase_file: Path | None) -> None:
    """On the host: install BUNDLE, which the root signed."""
    data = files.read(bundle, _MAX_FILE)
    secret = passphrase.read(passphrase_file, environment.variables)
    found = intermediate_home.install(environment.home, data, secret, now())
    powers = "renew and enroll" if found.may_enroll else "renew"
    record(may=powers, expires=found.not_after)
    say(f"this host may {powers} until {format_time(found.not_after)}")
