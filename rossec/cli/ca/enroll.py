"""`rossec ca enroll | requests | approve | deny`: requests for an identity, answered."""

import secrets
import sys
from hashlib import sha256
from pathlib import Path

import click

from ca.certificates import from_pem
from ca.enrollment import NONCE_SIZE, qr
from ca.enrollment.messages import Delivery, write
from ca.enrollment.sides import AuthorityEnrollment, group_digits
from ca.errors import HintedError
from ca.names import spiffe_id
from ca.store.values import OPEN, RequestRow, RequestState
from ca.svid import MAX_REQUEST
from rossec import clock, files
from rossec.authority.home import AuthorityHome, format_fingerprint
from rossec.authority.service import AuthorityService
from rossec.cli.ca import sign
from rossec.cli.ca.invitations import policy_lines
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, ask_yes_no, now, pass_environment, reraise_interrupt
from rossec.cli.shared.service import (
    give_outright,
    pass_service,
    publish_if_revoked,
    remind_to_publish,
    service_of,
)
from rossec.errors import ConfigurationError
from rossec.host import addresses
from rossec.terminal import printable, record, say

Destination = tuple[str, int]


@click.command()
@options.flag("--all everything", "also those that were answered")
@options.as_json
@pass_environment
def requests(environment: Environment, everything: bool, as_json: bool) -> None:
    """Show the requests for an identity that have no answer yet."""
    home = AuthorityHome.at(environment.home)
    store = home.store()
    at = now()
    store.requests.collect(at)
    rows = [row for row in store.requests.all(at) if everything or row.state in OPEN]
    lines = (line for row in rows for line in _lines(row)) if rows else ["no open requests"]
    options.say_result(as_json, [_summary(row) for row in rows], lines)


def _lines(row: RequestRow) -> list[str]:
    return [
        f"{row.digest.hex()[:8]}  {row.state}  {row.name}  {printable(row.source)}",
        f"  fingerprint {format_fingerprint(row.thumbprint)}  until {clock.format_time(row.expires)}",
    ]


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


@click.command()
@click.argument("request_ids", metavar="REQUEST_ID...", nargs=-1, required=True)
@sign.identity_lifetime
@sign.replace_key()
@sign.anonymous
@options.option("--out", "write the identity to this new file", type=options.PATH)
@options.master_uri
@options.json_result(pass_service)
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
    ids = options.unique(request_ids)
    if out is not None and len(ids) > 1:
        raise click.UsageError("--out is of one REQUEST_ID")
    if len(ids) > 1:
        service.unlock()  # a wrong passphrase is no fault of a request
    batch = options.Batch(len(ids), "id")
    for request_id in ids:
        with batch.item(request_id):
            row = service.identities.request(request_id)
            record(name=row.name)
            show_request(service, row, wildcard=anonymous)
            bundle = service.identities.issue(
                row.der, lifetime, replace_key=replaced, wildcard=anonymous, source=row.source
            )
            say(f"approved {row.name}")
            if out is not None:
                files.create(out, bundle, 0o644)
                say(f"signed: {out}; at the node: rossec node install {out.name}", file=str(out))
            give_outright(service, row.name)
    publish_if_revoked(service)
    batch.finish()


def show_request(service: AuthorityService, row: RequestRow, *, wildcard: bool) -> None:
    """Show all that matters before a name is given to a key."""
    home = service.home
    say(f"{spiffe_id(home.domain, row.name)} asks for an identity")
    say(f"  fingerprint {format_fingerprint(row.thumbprint)}")
    say(f"  from {printable(row.source)}")
    if wildcard:
        sign.warn_of_wildcard(row.name)
    # A name whose key changes is what an impostor would look like: it is said before all else.
    known = home.store().identities.valid(row.name, now())
    until = clock.format_time(known[-1].not_after) if known else ""
    if any(each.thumbprint != row.thumbprint for each in known):
        say(f"  WARNING: {row.name} is enrolled with ANOTHER KEY until {until}")
    elif known:
        say(f"  {row.name} is enrolled with this key until {until}")
    elif row.state is not RequestState.PENDING:
        say(f"  the request was {row.state} {clock.format_time(row.changed)}")
    else:
        say(f"  {row.name} is new here")
    from grants.policy.model import Subject  # noqa: PLC0415 - to list requests needs no policy
    from grants.policy.wanted import projected_grants  # noqa: PLC0415 - likewise
    from rossec.authority.policyfile import place  # noqa: PLC0415 - likewise

    subject = Subject(row.name, row.thumbprint, wildcard)
    path = place(service.rossec_home, None)
    for line in policy_lines(path, lambda policy: projected_grants(policy, subject), "it", "this name"):
        say(f"  {line}")


@click.command()
@click.argument("request_ids", metavar="REQUEST_ID...", nargs=-1, required=True)
@options.reason
@options.json_result(pass_environment)
def deny(environment: Environment, request_ids: tuple[str, ...], reason: str) -> None:
    """Deny the request REQUEST_ID (or its beginning).

    Where one of several is refused the others are denied, and the exit code is 1.
    """
    service, ids = service_of(environment), options.unique(request_ids)
    batch = options.Batch(len(ids), "id")
    for request_id in ids:
        with batch.item(request_id):
            row = service.identities.request(request_id)
            service.identities.deny_request(row, reason)
            say(f"denied {row.name}", name=row.name)
    batch.finish()


@click.command()
@click.argument("code", required=False)
@options.image
@options.option(
    "--csr csr_file", "no code: this request, whose fingerprint you have compared", type=options.FILE
)
@options.option("--address given_address", "where the node waits, for a label: host, or host:port")
@sign.identity_lifetime
@sign.replace_key()
@sign.anonymous
@options.flag("--later", "only record the request; decide with: rossec ca approve")
@options.master_uri
@options.yes
@options.json_result(pass_service)
def enroll(
    service: AuthorityService,
    code: str | None,
    image: Path | None,
    csr_file: Path | None,
    given_address: str | None,
    lifetime: int,
    replaced: str | None,
    anonymous: bool,
    later: bool,
    yes: bool,
) -> None:
    """Enroll the node that shows CODE: scanned from a picture, or pasted (in single quotes).

    Without any of these options the command asks for the text.

    Shows the request and what the policy grants that name, asks you, signs, and delivers the
    identity. Then both sides show six digits: go to the node and confirm there if they are the
    same. With --csr and no --address the identity is written beside the request, to be carried.

    Exit codes: 0 enrolled, 1 refused, 2 wrong usage, 3 signed here but the node did not say that it
    is enrolled, or the master was unreachable; 130 interrupted.
    """
    import asyncio  # noqa: PLC0415 - this verb alone meets a node

    from rossec.enrollment import deliver, fetch  # noqa: PLC0415 - likewise

    # 1. The code, and where its node waits.
    domain = service.home.domain
    found = _read_code(code, image, csr_file)
    destination = _destination(found, given_address, csr_file)
    # 2. The request that the code is of.
    core = AuthorityEnrollment(found, domain, wildcard=anonymous)
    if csr_file is not None:
        core.receive(write(Delivery(sign.read_request(csr_file, MAX_REQUEST))), now())
    else:
        assert destination is not None  # noqa: S101 - a code without an address was refused
        asyncio.run(fetch(core, *destination, now))
    source = "a screen code" if found.secret else "a label" if csr_file is None else "a file"
    source += "" if destination is None else f" at {addresses.join(*destination)}"
    row = service.identities.add_request(core.request, core.csr, source)
    record(name=row.name, request=row.digest.hex(), state="pending")
    # 3. A person decides, who sees all of it.
    show_request(service, row, wildcard=core.request.wildcard)
    if later:
        say(f"recorded; decide with: rossec ca approve {row.digest.hex()[:8]}, or deny")
        return
    if row.state is RequestState.PENDING and not ask_yes_no("give this name to this key?", yes=yes):
        service.identities.deny_request(row, "denied at the authority")
        record(state="denied")
        raise ConfigurationError("denied", "to ask again the node needs a new request")
    # 4. The identity, which is recorded before it is delivered: what was signed can be revoked.
    core.approve(now())
    bundle = service.identities.issue(
        row.der, lifetime, replace_key=replaced, wildcard=core.request.wildcard, source=row.source
    )
    record(state="signed")
    if destination is None:
        assert csr_file is not None  # noqa: S101 - without an address there is a file
        target = sign.write_identity(csr_file, bundle)
        say(f"signed: {target}; at the node: rossec node install {target.name}", file=str(target))
    else:

        def show_digits(digits: str) -> None:
            say(f"digits {group_digits(digits)}")
            say("the same at the node? then confirm there; if not, stop here and there")

        try:
            *chain, root = from_pem(bundle)
            offer = core.offer(chain, root, secrets.token_bytes(NONCE_SIZE), now())
            asyncio.run(deliver(core, offer, *destination, now, show_digits))
        except HintedError:
            remind_to_publish(service)
            raise
        say(f"enrolled {row.name}", state="enrolled")
    give_outright(service, row.name)
    publish_if_revoked(service)


def _read_code(code: str | None, image: Path | None, csr_file: Path | None) -> qr.Code:
    from rossec.enrollment import code_in_file  # noqa: PLC0415 - see above

    if sys.stdin.isatty() and (code, image, csr_file) == (None, None, None):
        try:
            typed: str = click.prompt("the text below the code", err=True)
        except click.Abort as abort:
            reraise_interrupt(abort)
            raise ConfigurationError("no code was given", "paste the line with ROSSEC:") from None
        code = typed
    match (code, image, csr_file):
        case (str(), None, None):
            found = qr.parse(code)
        case (None, Path(), None):
            found = qr.parse(code_in_file(image, sys.stdin.buffer))
        case (None, None, Path()):  # its fingerprint was compared: it has no time
            return qr.Code(sha256(sign.read_request(csr_file, MAX_REQUEST)).digest())
        case _:
            raise click.UsageError("give a code, or --image, or --csr: one of them")
    found.check_time(now())
    return found


def _destination(code: qr.Code, given_address: str | None, csr_file: Path | None) -> Destination | None:
    if given_address is not None or code.address:
        return addresses.split(given_address or code.address)
    if csr_file is not None:
        return None
    raise ConfigurationError(
        "a label does not say where its node is", "add --address HOST, as the node shows it"
    )
