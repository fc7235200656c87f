"""`rossec border add | install`: on the border router, a thing before and after the authority."""

from pathlib import Path
from typing import Final

import click

from ca.certificates import check_request
from ca.enrollment import qr
from ca.things.credentials import ThingSecret, read_ccs
from ca.things.secret_codes import secret_text
from ca.things.statement import MAX_STATEMENT, check_thing_name
from rossec import files
from rossec.authority.home import format_fingerprint
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.saved_things import ThingFiles
from rossec.terminal import note, record, say, say_picture, say_secret

BORDER: Final = "/border"
_MAX_CREDENTIAL: Final = 4096
_MAX_BUNDLE: Final = 64 * 1024

as_border = click.option(
    "--as", "router", metavar="NAME", default=BORDER, show_default=True, help="the border router"
)


@click.command()
@click.argument("name")
@click.option("--key", "ccs", type=options.FILE, help="the thing's credential: a CCS, as CBOR")
@click.option("--psk", is_flag=True, help="it has no curves: make a secret for it")
@click.option(
    "--secret-out", type=click.Path(path_type=Path, dir_okay=False),
    help="write the secret for the thing to this new file, and do not show it",
)  # fmt: skip
@as_border
@json_result(secret=True)
@pass_environment
def add(
    environment: Environment, name: str, ccs: Path | None, psk: bool, secret_out: Path | None,
    router: str,
) -> None:  # fmt: skip
    """Prepare the thing NAME: the request of its node, and its secret if it has one.

    The keys of the thing's node and its secret stay here; the secret is shown once, for the thing.
    """
    if (ccs is None) is not psk:
        raise ConfigurationError("a thing has a key or a secret", "give --key FILE or --psk")
    if secret_out is not None and not psk:
        raise ConfigurationError("a thing with a key has no secret here", "leave --secret-out out")
    home = NodeHome.of(environment.home, router)
    domain = home.identity(now()).domain
    check_thing_name(name)
    if ccs is not None:
        found = read_ccs(files.read(ccs, _MAX_CREDENTIAL))
        say(f"key of {name}: fingerprint {format_fingerprint(found.thumbprint)}")
        option = f"--key {ccs}"
    else:
        option = f"--psk {_secret(ThingFiles(home), name, secret_out)}"
    node = NodeHome.of(environment.home, name)
    csr = node.label_request(domain)
    record(name=name, file=str(node.request_path))
    say(f"request of {name}: {node.request_path}")
    say(f"fingerprint {format_fingerprint(check_request(csr, domain).thumbprint)}")
    request = f"--request {node.request_path}"
    say(f"next, at the authority: rossec ca thing {name} --border {router} {option} {request}")


def _secret(things: ThingFiles, name: str, out: Path | None) -> Path:
    """Make a secret, give it to its owner, and return the file that describes it."""
    if out is not None and out.exists():
        raise ConfigurationError(f"{out} exists and is not overwritten", "name a new file")
    if out is not None and not out.parent.is_dir():  # before a secret is made that nobody gets
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")
    secret = things.create_secret(name)
    known = ThingSecret.of(secret, things.free_kid())
    text = secret_text(known.kid, secret)
    described = things.describe_secret(name, known)
    if out is not None:
        files.create(out, f"{text}\n".encode())
        record(secret_file=str(out))
        say(f"secret of {name}: {out}")
    else:
        note("whoever sees this can speak as the thing; it is not shown again")
        record(secret=text)
        say_picture(qr.terminal(text), is_secret=True)
        say_secret(text)
    return described


@click.command()
@click.argument("statement", type=options.FILE)
@click.argument("bundle", type=options.FILE, required=False)
@as_border
@json_result()
@pass_environment
def install(environment: Environment, statement: Path, bundle: Path | None, router: str) -> None:
    """Install what the authority signed about a thing: STATEMENT, and the identity in BUNDLE.

    A border router that runs takes it at once.
    """
    home = NodeHome.of(environment.home, router)
    home.identity(now())
    if bundle is not None:
        pem = files.read(bundle, _MAX_BUNDLE)
        node, anchor = NodeHome.for_bundle(environment.home, pem, now())
        if anchor.thumbprint != home.anchor().thumbprint:
            raise ConfigurationError(
                f"{bundle} is of another authority than that of {router}", "take the right file"
            )
        node.install(pem, now())
        record(identity=node.name, domain=anchor.domain)
        say(f"{node.name} is enrolled in {anchor.domain}")
    found = ThingFiles(home).install(files.read(statement, MAX_STATEMENT))
    record(name=found.name, expires=found.expires)
    say(f"{found.name} is served until {format_time(found.expires)}")
    if not (NodeHome.of(environment.home, found.name).path / "node.pem").exists():
        note(f"the node {found.name} has no identity here yet: rossec node install FILE")
