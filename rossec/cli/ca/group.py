"""`rossec ca`: create the authority, sign identities, look at what was signed."""

import asyncio
from pathlib import Path

import click

from ca.certificates import IdentityRequest, check_request
from ca.enrollment import qr
from ca.keys.hsm import KeyUri
from ca.names import check_wildcard, spiffe_id
from rossec import files
from rossec.authority.home import AuthorityHome, fingerprint, format_fingerprint
from rossec.authority.renewals import own_node_is_due, renew_own_node
from rossec.authority.signing import OWN_NODE
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.batch import Batch
from rossec.cli.shared.context import Environment, confirm, moment, now, pass_environment
from rossec.cli.shared.delivery import deliver, remind
from rossec.errors import ConfigurationError
from rossec.terminal import note, printable, say

_MAX_REQUEST = 16 * 1024


@click.group()
def ca() -> None:
    """Run the authority: it says who is who."""


@ca.command()
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


@ca.command()
@click.argument(
    "requests",
    nargs=-1,
    required=True,
    type=click.Path(path_type=Path, exists=True, dir_okay=False),
)
@click.option(
    "--code", "codes", multiple=True, help="text of the QR code the node shows; one per request"
)
@options.identity_lifetime
@options.replace_key(multiple=True)
@options.anonymous
@options.master_to_tell
@click.option("--yes", is_flag=True, help="do not ask")
@passphrase.option
@pass_environment
def sign(
    environment: Environment,
    requests: tuple[Path, ...],
    codes: tuple[str, ...],
    lifetime: int,
    replaced: tuple[str, ...],
    anonymous: bool,
    master_uri: str | None,
    yes: bool,
    passphrase_file: Path | None,
) -> None:
    """Sign the identity requests in REQUESTS, after showing who asks.

    Each certificate is written beside its request, as node.pem. With --code the request must be the
    one the code was made for: scan or paste it from the node's own screen. Where one of several is
    refused the others are signed, and the exit code is 1.
    """
    home, batch = AuthorityHome.at(environment.home), Batch(len(requests))
    read = [(path, _read(path)) for path in requests]
    if codes:
        _check_codes(codes, [data for _, data in read])
    asked: list[tuple[Path, bytes, str]] = []
    for path, data in read:
        with batch.one(path):
            request = check_request(data, home.domain, wildcard=anonymous)
            _introduce(path, request, home, vouched=bool(codes))
            if anonymous:
                warn_of_tail(request.name)
            asked.append((path, data, request.name))
    if asked:
        confirm(f"sign {_count(len(asked))}?", yes=yes)
        authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
        revoked, number = authority.store.revoked_entries(), authority.store.next_number()
        for path, data, name in asked:
            with batch.one(path):
                bundle = authority.issue(
                    data, now(), lifetime,
                    replace_key=name if name in replaced else None, wildcard=anonymous,
                )  # fmt: skip
                _hand_out(path, bundle, name)
        if authority.store.revoked_entries() != revoked:
            say("the replaced key is revoked")
            _tell(environment, master_uri)
        else:
            remind(authority.store, number)
    batch.end()


def _hand_out(path: Path, bundle: bytes, name: str) -> None:
    target = path.with_name("node.pem" if path.name == "node.csr" else f"{path.stem}.pem")
    files.replace(target, bundle, 0o644)
    say(f"signed {name}: {target}")


@ca.command()
@options.master_to_tell
@passphrase.option
@pass_environment
def publish(environment: Environment, master_uri: str | None, passphrase_file: Path | None) -> None:
    """Give the newest revocation list to the master.

    The passphrase is needed only where something is revoked that no signed list says yet.
    """
    home = AuthorityHome.at(environment.home)
    if count := home.count_unlisted(now()):
        note(f"{count} revocation{'s' * (count != 1)} in no signed list yet: it is signed anew")
        home.unlock(passphrase.read(passphrase_file, environment.variables)).refresh_list(now())
    asyncio.run(deliver(environment, master_uri))
    say("the master has the newest list")


@ca.command()
@options.master_to_tell
@passphrase.option
@pass_environment
def refresh(environment: Environment, master_uri: str | None, passphrase_file: Path | None) -> None:
    """Sign the revocation list anew, before it expires, and give it to the master.

    The authority's own node is renewed as well when two thirds of its life are over.
    """
    home = AuthorityHome.at(environment.home)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    if own_node_is_due(authority, now()):
        say(f"renewed {OWN_NODE} until {moment(renew_own_node(authority, now()))}")
    listed = authority.sign_list(now())
    say(f"list {listed.seq} holds until {moment(listed.expires)}")
    _tell(environment, master_uri)


@ca.command()
@click.argument("name")
@click.option("--reason", default="", help="why, for the record")
@options.master_to_tell
@passphrase.option
@pass_environment
def revoke(
    environment: Environment,
    name: str,
    reason: str,
    master_uri: str | None,
    passphrase_file: Path | None,
) -> None:
    """Revoke the identity of the node NAME, and tell the master at once.

    Its connections end and its key is never trusted again; to return it needs a new key.
    """
    home = AuthorityHome.at(environment.home)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    listed, count = authority.revoke_identity(name, reason, now())
    say(f"revoked {name}, {count} key{'s' * (count != 1)} (list {listed.seq})")
    _tell(environment, master_uri)


def _tell(environment: Environment, master_uri: str | None) -> None:
    asyncio.run(deliver(environment, master_uri))
    say("the master has the new list")


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


def _introduce(path: Path, request: IdentityRequest, home: AuthorityHome, *, vouched: bool) -> None:
    how = (
        "its code fits"
        if vouched
        else "no code was checked: compare the fingerprint with the one the node shows"
    )
    say(f"{printable(spiffe_id(home.domain, request.name))} asks for an identity ({path})")
    say(f"  fingerprint {format_fingerprint(request.thumbprint)}")
    say(f"  {how}")


def warn_of_tail(name: str) -> None:
    """Say what a wildcard tail means.

    Raises:
        NameRefused: a name that cannot have one.
    """
    check_wildcard(name)
    say(f"  it may run as any number of nodes, under every name that begins with {name}_")
    say("  all of them have one key and the same grants, and are revoked together")


def _read(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(_MAX_REQUEST + 1)


def _count(number: int) -> str:
    return "this identity" if number == 1 else f"these {number} identities"
