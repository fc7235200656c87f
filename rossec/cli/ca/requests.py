"""`rossec ca requests | approve | deny`: requests for an identity, and their answers."""

from pathlib import Path

import click

from ca.names import spiffe_id
from ca.store.lifecycle import OPEN, RequestRow, RequestState
from ca.store.record import Store
from grants.policy.model import Subject
from grants.policy.projected_grants import projected_grants
from rossec import files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.policyfile import PolicyFile, place
from rossec.authority.service import AuthorityService
from rossec.cli.ca.sign import warn_of_wildcard
from rossec.cli.shared import options, signing_options
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.outright import give_outright
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_if_revoked, service_of
from rossec.clock import format_time
from rossec.terminal import printable, record, say, say_json


@click.command()
@click.option("--all", "everything", is_flag=True, help="also those that were answered")
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def requests(environment: Environment, everything: bool, as_json: bool) -> None:
    """Show the requests for an identity that have no answer yet."""
    home = AuthorityHome.at(environment.home)
    store = home.store()
    at = now()
    store.requests.collect(at)
    rows = [row for row in store.requests.all(at) if everything or row.state in OPEN]
    if as_json:
        say_json([_summary(row) for row in rows])
        return
    for row in rows:
        say(f"{row.digest.hex()[:8]}  {row.state}  {row.name}  {printable(row.source)}")
        say(f"  fingerprint {format_fingerprint(row.thumbprint)}  until {format_time(row.expires)}")
    if not rows:
        say("no open requests")


@click.command()
@click.argument("request_ids", metavar="REQUEST_ID...", nargs=-1, required=True)
@signing_options.identity_lifetime
@signing_options.replace_key()
@signing_options.anonymous
@click.option("--out", type=click.Path(path_type=Path), help="write the identity to this new file")
@options.master_uri
@json_result()
@pass_service
def approve(
    service: AuthorityService,
    request_ids: tuple[str, ...],
    lifetime: int,
    replaced: str | None,
    anonymous: bool,
    out: Path | None,
) -> None:
    """Approve the request REQUEST_ID (or its beginning), and sign its identity.

    It is written to --out, to be copied; or `rossec ca enroll` delivers it without asking again.
    Where one of several is refused the others are approved, and the exit code is 1.
    """
    ids = unique(request_ids)
    if out is not None and len(ids) > 1:
        raise click.UsageError("--out is of one REQUEST_ID")
    if len(ids) > 1:
        service.unlock()  # a wrong passphrase is no fault of a request
    batch = Batch(len(ids), "id")
    for request_id in ids:
        with batch.item(request_id):
            row = service.request(request_id)
            record(name=row.name)
            show_request(service, row, wildcard=anonymous)
            bundle = service.issue(
                row.der, lifetime, replace_key=replaced, wildcard=anonymous, source=row.source
            )
            say(f"approved {row.name}")
            if out is not None:
                files.create(out, bundle, 0o644)
                record(file=str(out))
                say(f"signed: {out}; at the node: rossec node install {out.name}")
            give_outright(service, row.name)
    publish_if_revoked(service)
    batch.finish()


@click.command()
@click.argument("request_ids", metavar="REQUEST_ID...", nargs=-1, required=True)
@click.option("--reason", default="", help="why, for the record")
@json_result()
@pass_environment
def deny(environment: Environment, request_ids: tuple[str, ...], reason: str) -> None:
    """Deny the request REQUEST_ID (or its beginning).

    Where one of several is refused the others are denied, and the exit code is 1.
    """
    service, ids = service_of(environment), unique(request_ids)
    batch = Batch(len(ids), "id")
    for request_id in ids:
        with batch.item(request_id):
            row = service.request(request_id)
            service.deny_request(row, reason)
            record(name=row.name)
            say(f"denied {row.name}")
    batch.finish()


def show_request(service: AuthorityService, row: RequestRow, *, wildcard: bool) -> None:
    """Show all that matters before a name is given to a key."""
    home = service.home
    say(f"{spiffe_id(home.domain, row.name)} asks for an identity")
    say(f"  fingerprint {format_fingerprint(row.thumbprint)}")
    say(f"  from {printable(row.source)}")
    if wildcard:
        warn_of_wildcard(row.name)
    say(f"  {_enrollment_status(home.store(), row)}")
    for line in _policy_lines(place(service.rossec_home, None), row, wildcard=wildcard):
        say(f"  {line}")


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


def _policy_lines(path: Path, row: RequestRow, *, wildcard: bool) -> list[str]:
    if not path.exists():
        return ["there is no policy: it is granted nothing"]
    policy = PolicyFile.read(path, own=True).policy
    lines = projected_grants(policy, Subject(row.name, row.thumbprint, wildcard))
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
