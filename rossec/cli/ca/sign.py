"""`rossec ca sign`: sign the identity requests of nodes."""

from pathlib import Path

import click

from ca.certificates import IdentityRequest, check_request
from ca.enrollment import qr
from ca.names import check_wildcard, spiffe_id
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options, signing_options
from rossec.cli.shared.batch import Batch
from rossec.cli.shared.context import confirm, now
from rossec.cli.shared.outright import give_outright
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_if_revoked
from rossec.errors import ConfigurationError
from rossec.terminal import printable, record, say

_MAX_REQUEST = 16 * 1024


@click.command()
@click.argument("requests", nargs=-1, required=True, type=options.FILE)
@click.option(
    "--code", "codes", multiple=True, help="text of the QR code the node shows; one per request"
)
@signing_options.identity_lifetime
@signing_options.replace_key(multiple=True)
@signing_options.anonymous
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@json_result()
@pass_service
def sign(
    service: AuthorityService,
    requests: tuple[Path, ...],
    codes: tuple[str, ...],
    lifetime: int,
    replaced: tuple[str, ...],
    anonymous: bool,
    yes: bool,
) -> None:
    """Sign the identity requests in REQUESTS, after showing them.

    Each certificate is written beside its request, as node.pem. With --code the request must be the
    one the code was made for: scan or paste it from the node's own screen. Where one of several is
    refused the others are signed, and the exit code is 1.
    """
    home, batch = service.home, Batch(len(requests))
    read = [(path, _read(path)) for path in requests]
    if codes:
        _check_codes(codes, [data for _, data in read])
    checked: list[tuple[Path, bytes, str]] = []
    for path, data in read:
        with batch.item(path, last=False):
            request = check_request(data, home.domain, wildcard=anonymous)
            _show_request(path, request, home, code_checked=bool(codes))
            if anonymous:
                warn_of_wildcard(request.name)
            checked.append((path, data, request.name))
    if checked:
        confirm(f"sign {_count(len(checked))}?", yes=yes)
        service.unlock()
        for path, data, name in checked:
            with batch.item(path):
                key = name if name in replaced else None
                bundle = service.issue(
                    data, lifetime, replace_key=key, wildcard=anonymous, source="file"
                )
                target = write_identity(path, bundle)
                record(name=name, identity=str(target))
                say(f"signed {name}: {target}")
                give_outright(service, name)
        publish_if_revoked(service)
    batch.finish()


def write_identity(request: Path, bundle: bytes) -> Path:
    """Write an identity beside its request; returns where."""
    name = "node.pem" if request.name == "node.csr" else f"{request.stem}.pem"
    target = request.with_name(name)
    files.replace(target, bundle, 0o644)
    return target


def _check_codes(codes: tuple[str, ...], requests: list[bytes]) -> None:
    """Every request needs its code, and every code its request."""
    parsed = [qr.parse(text) for text in codes]
    for code in parsed:
        code.check_time(now())
    unmatched = [data for data in requests if not any(code.matches(data) for code in parsed)]
    if unmatched or len(parsed) != len(requests):
        raise ConfigurationError(
            "a request does not fit the codes: it was changed on its way, or is another node's",
            "scan the code again from the screen of the node itself",
        )


def _show_request(
    path: Path, request: IdentityRequest, home: AuthorityHome, *, code_checked: bool
) -> None:
    how = (
        "its code fits"
        if code_checked
        else "no code was checked: compare the fingerprint with the one the node shows"
    )
    say(f"{printable(spiffe_id(home.domain, request.name))} asks for an identity ({path})")
    say(f"  fingerprint {format_fingerprint(request.thumbprint)}")
    say(f"  {how}")


def warn_of_wildcard(name: str) -> None:
    """Print what a wildcard identity allows.

    Raises:
        NameRefused: a name that cannot be a wildcard.
    """
    check_wildcard(name)
    say(f"  it may run as any number of nodes, under every name that begins with {name}_")
    say("  all of them have one key and the same grants, and are revoked together")


def _read(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_MAX_REQUEST + 1)


def _count(number: int) -> str:
    return "this identity" if number == 1 else f"these {number} identities"
