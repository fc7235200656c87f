"""`rossec ca requests | approve | deny`: requests for an identity, and their answers."""

from pathlib import Path
from typing import Final

import click

from ca.names import spiffe_id
from ca.store.lifecycle import OPEN, RequestRow, RequestState
from ca.store.record import Store
from grants.policy.model import Subject
from grants.policy.projected_grants import projected_grants
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.policyfile import PolicyFile, place
from rossec.authority.signing import SigningAuthority
from rossec.cli.ca.sign import warn_of_wildcard
from rossec.cli.shared import options, passphrase, signing_options
from rossec.cli.shared.context import Environment, format_time, now, pass_environment
from rossec.cli.shared.delivery import publish_list, remind_to_publish
from rossec.errors import ConfigurationError
from rossec.terminal import printable, say, say_json

_SHORT: Final = 8


@click.command()
@click.option("--all", "everything", is_flag=True, help="also those that were answered")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def requests(environment: Environment, everything: bool, as_json: bool) -> None:
    """Show the requests for an identity that have no answer yet."""
    home = AuthorityHome.at(environment.home)
    store = home.store()
    store.requests.collect(now())
    rows = [row for row in store.requests.all() if everything or row.state in OPEN]
    if as_json:
        say_json([_summary(row) for row in rows])
        return
    for row in rows:
        say(f"{_short(row)}  {row.state}  {row.name}  {printable(row.source)}")
        say(f"  fingerprint {format_fingerprint(row.thumbprint)}  until {format_time(row.expires)}")
    if not rows:
        say("no open requests")


@click.command()
@click.argument("request_id")
@signing_options.identity_lifetime
@signing_options.replace_key()
@signing_options.anonymous
@click.option("--out", type=click.Path(path_type=Path), help="write the identity to this new file")
@options.master_uri
@passphrase.option
@pass_environment
def approve(
    environment: Environment,
    request_id: str,
    lifetime: int,
    replaced: str | None,
    anonymous: bool,
    out: Path | None,
    master_uri: str | None,
    passphrase_file: Path | None,
) -> None:
    """Approve the request REQUEST_ID (or its beginning), and sign its identity.

    It is written to --out, to be copied; or `rossec ca enroll` delivers it without asking again.
    """
    home = AuthorityHome.at(environment.home)
    row = home.store().requests.get(_digest(request_id))
    show_request(environment, row, home, wildcard=anonymous)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    revoked, number = authority.store.revoked_entries(), authority.store.next_number()
    bundle = authority.issue(
        row.der, now(), lifetime, replace_key=replaced, wildcard=anonymous, source=row.source
    )
    say(f"approved {row.name}")
    if out is not None:
        files.create(out, bundle, 0o644)
        say(f"signed: {out}; at the node: rossec node install {out.name}")
    publish_if_revoked(environment, authority, revoked, number, master_uri)


@click.command()
@click.argument("request_id")
@click.option("--reason", default="", help="why, for the record")
@pass_environment
def deny(environment: Environment, request_id: str, reason: str) -> None:
    """Deny the request REQUEST_ID (or its beginning)."""
    store = AuthorityHome.at(environment.home).store()
    row = store.requests.deny(_digest(request_id), now(), reason)
    say(f"denied {row.name}")


def show_request(
    environment: Environment, row: RequestRow, home: AuthorityHome, *, wildcard: bool
) -> None:
    """Show all that matters before a name is given to a key."""
    say(f"{spiffe_id(home.domain, row.name)} asks for an identity")
    say(f"  fingerprint {format_fingerprint(row.thumbprint)}")
    say(f"  from {printable(row.source)}")
    if wildcard:
        warn_of_wildcard(row.name)
    say(f"  {_enrollment_status(home.store(), row)}")
    for line in _policy_lines(environment, row):
        say(f"  {line}")


def publish_if_revoked(
    environment: Environment,
    authority: SigningAuthority,
    revoked: frozenset[bytes],
    number: tuple[int, int],
    master_uri: str | None,
) -> None:
    """Deliver the list if a replaced key was revoked: `revoked` are the entries before."""
    if authority.store.revoked_entries() == revoked:
        remind_to_publish(authority.store, number)
        return
    say("the replaced key is revoked")
    publish_list(environment, master_uri)


def _enrollment_status(store: Store, row: RequestRow) -> str:
    """Whether the name is enrolled already, and with which key."""
    known = store.identities.valid(row.name, now())
    if any(each.thumbprint != row.thumbprint for each in known):
        until = format_time(known[-1].not_after)
        return f"WARNING: {row.name} is enrolled with ANOTHER KEY until {until}"
    if known:
        return f"{row.name} is enrolled with this key until {format_time(known[-1].not_after)}"
    if row.state is not RequestState.PENDING:
        return f"the request was {row.state} {format_time(row.changed)}"
    return f"{row.name} is new here"


def _policy_lines(environment: Environment, row: RequestRow) -> list[str]:
    path = place(environment.home, None)
    if not path.exists():
        return ["there is no policy: it is granted nothing"]
    policy = PolicyFile.read(path, own=True).policy
    lines = projected_grants(policy, Subject(row.name, row.thumbprint))
    if not lines:
        return [f"the policy has no rule for it: {policy.defaults.decision}"]
    return ["the policy for this name:", *(f"  {line}" for line in lines)]


def _summary(row: RequestRow) -> dict[str, object]:
    return {
        "request": row.digest.hex(),
        "state": row.state,
        "name": row.name,
        "key": row.thumbprint.hex(),
        "source": row.source,
        "arrived": row.arrived,
        "until": row.expires,
        "reason": row.reason,
    }


def _digest(text: str) -> bytes:
    """The beginning of a digest; an odd last digit is ignored."""
    try:
        return bytes.fromhex(text[: len(text) // 2 * 2])
    except ValueError:
        raise ConfigurationError(
            f"{text!a} is not a request id", "see: rossec ca requests"
        ) from None


def _short(row: RequestRow) -> str:
    return row.digest.hex()[:_SHORT]
