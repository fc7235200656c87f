"""`rossec ca requests | approve | deny`: who asks for an identity, and what was answered."""

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
from rossec.cli.ca.sign import warn_of_tail
from rossec.cli.shared import options, passphrase, signing_options
from rossec.cli.shared.context import Environment, moment, now, pass_environment
from rossec.cli.shared.delivery import publish_list, remind
from rossec.errors import ConfigurationError
from rossec.terminal import printable, say, say_json

_SHORT: Final = 8


@click.command()
@click.option("--all", "everything", is_flag=True, help="also those that were answered")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def requests(environment: Environment, everything: bool, as_json: bool) -> None:
    """Show who asks for an identity and has no answer yet."""
    home = AuthorityHome.at(environment.home)
    store = home.store()
    store.requests.collect(now())
    rows = [row for row in store.requests.all() if everything or row.state in OPEN]
    if as_json:
        say_json([_summary(row) for row in rows])
        return
    for row in rows:
        say(f"{_short(row)}  {row.state}  {row.name}  {printable(row.source)}")
        say(f"  fingerprint {format_fingerprint(row.thumbprint)}  until {moment(row.expires)}")
    if not rows:
        say("nobody asks for anything")


@click.command()
@click.argument("request_id")
@signing_options.identity_lifetime
@signing_options.replace_key()
@signing_options.anonymous
@click.option("--out", type=click.Path(path_type=Path), help="write the identity to this new file")
@options.master_to_tell
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
    """Say yes to the request REQUEST_ID (or its beginning), and sign its identity.

    It is written to --out, to be carried; or `rossec ca enroll` hands it over without asking again.
    """
    home = AuthorityHome.at(environment.home)
    row = home.store().requests.get(_digest(request_id))
    introduce(environment, row, home, wildcard=anonymous)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    revoked, number = authority.store.revoked_entries(), authority.store.next_number()
    bundle = authority.issue(
        row.der, now(), lifetime, replace_key=replaced, wildcard=anonymous, source=row.source
    )
    say(f"approved {row.name}")
    if out is not None:
        files.create(out, bundle, 0o644)
        say(f"signed: {out}; at the node: rossec node install {out.name}")
    tell_of_replaced(environment, authority, revoked, number, master_uri)


@click.command()
@click.argument("request_id")
@click.option("--reason", default="", help="why, for the record")
@pass_environment
def deny(environment: Environment, request_id: str, reason: str) -> None:
    """Say no to the request REQUEST_ID (or its beginning)."""
    store = AuthorityHome.at(environment.home).store()
    row = store.requests.deny(_digest(request_id), now(), reason)
    say(f"denied {row.name}")


def introduce(
    environment: Environment, row: RequestRow, home: AuthorityHome, *, wildcard: bool
) -> None:
    """Everything a person should know before giving a name to a key."""
    say(f"{spiffe_id(home.domain, row.name)} asks for an identity")
    say(f"  fingerprint {format_fingerprint(row.thumbprint)}")
    say(f"  from {printable(row.source)}")
    if wildcard:
        warn_of_tail(row.name)
    say(f"  {_standing(home.store(), row)}")
    for line in _prospects(environment, row):
        say(f"  {line}")


def tell_of_replaced(
    environment: Environment,
    authority: SigningAuthority,
    revoked: frozenset[bytes],
    number: tuple[int, int],
    master_uri: str | None,
) -> None:
    """Carry the list to the master when a key was replaced since it held `revoked`."""
    if authority.store.revoked_entries() == revoked:
        remind(authority.store, number)
        return
    say("the replaced key is revoked")
    publish_list(environment, master_uri)


def _standing(store: Store, row: RequestRow) -> str:
    """Whether the name is known here: the one thing that must not be overlooked."""
    known = store.identities.valid(row.name, now())
    if any(each.thumbprint != row.thumbprint for each in known):
        return (
            f"WARNING: {row.name} is enrolled with ANOTHER KEY until {moment(known[-1].not_after)}"
        )
    if known:
        return f"{row.name} is enrolled with this key until {moment(known[-1].not_after)}"
    if row.state is not RequestState.PENDING:
        return f"the request was {row.state} {moment(row.changed)}"
    return f"{row.name} is new here"


def _prospects(environment: Environment, row: RequestRow) -> list[str]:
    path = place(environment.home, None)
    if not path.exists():
        return ["there is no policy: it gets nothing by itself"]
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
    """The beginning of a digest; an odd digit too many is left out of the search."""
    try:
        return bytes.fromhex(text[: len(text) // 2 * 2])
    except ValueError:
        raise ConfigurationError(f"{text!a} is no request", "see: rossec ca requests") from None


def _short(row: RequestRow) -> str:
    return row.digest.hex()[:_SHORT]
