"""`rossec ca enroll`: read a node's code, show its request, and sign its identity."""

import asyncio
import secrets
import sys
from hashlib import sha256
from pathlib import Path
from typing import Final

import click

from ca.certificates import from_pem
from ca.enrollment import NONCE_SIZE, qr
from ca.enrollment.authority import AuthorityEnrollment
from ca.enrollment.messages import Delivery, write
from ca.enrollment.transcript import group_digits
from ca.errors import HintedError
from ca.requests import MAX_REQUEST
from ca.store.lifecycle import RequestState
from rossec.authority.service import AuthorityService
from rossec.cli.ca.requests import show_request
from rossec.cli.ca.sign import write_identity
from rossec.cli.shared import options, signing_options
from rossec.cli.shared.context import ask_yes_no, now, reraise_interrupt
from rossec.cli.shared.outright import give_outright
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_if_revoked, remind_to_publish
from rossec.enrollment import address
from rossec.enrollment.authority import deliver, fetch
from rossec.enrollment.scan import code_in_file
from rossec.errors import ConfigurationError
from rossec.terminal import record, say

Destination = tuple[str, int]
_DENIED: Final = "denied at the authority"


@click.command()
@click.argument("code", required=False)
@click.option(
    "--image", type=click.Path(path_type=Path, exists=True, dir_okay=False, allow_dash=True),
    help="read the code from this picture; - is standard input",
)  # fmt: skip
@click.option(
    "--csr", "csr_file", type=options.FILE,
    help="no code: this request, whose fingerprint you have compared",
)  # fmt: skip
@click.option(
    "--address", "given_address", help="where the node waits, for a label: host, or host:port"
)
@signing_options.identity_lifetime
@signing_options.replace_key()
@signing_options.anonymous
@click.option(
    "--later", is_flag=True, help="only record the request; decide with: rossec ca approve"
)
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@json_result()
@pass_service
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
    domain = service.home.domain
    found = _read_code(code, image, csr_file)
    destination = _destination(found, given_address, csr_file)
    core = AuthorityEnrollment(found, domain, wildcard=anonymous)
    _fetch_request(core, csr_file, destination)
    row = service.add_request(core.request, core.csr, _source(found, csr_file, destination))
    record(name=row.name, request=row.digest.hex(), state="pending")
    show_request(service, row, wildcard=core.request.wildcard)
    if later:
        say(f"recorded; decide with: rossec ca approve {row.digest.hex()[:8]}, or deny")
        return
    if row.state is RequestState.PENDING and not ask_yes_no("give this name to this key?", yes=yes):
        service.deny_request(row, _DENIED)
        record(state="denied")
        raise ConfigurationError("denied", "to ask again the node needs a new request")
    core.approve(now())
    bundle = service.issue(
        row.der, lifetime,
        replace_key=replaced, wildcard=core.request.wildcard, source=row.source,
    )  # fmt: skip
    record(state="signed")
    if destination is None:
        assert csr_file is not None  # noqa: S101 - without an address there is a file
        target = write_identity(csr_file, bundle)
        record(file=str(target))
        say(f"signed: {target}; at the node: rossec node install {target.name}")
    else:
        try:
            _deliver_identity(core, bundle, destination)
        except HintedError:
            remind_to_publish(service)
            raise
        record(state="enrolled")
        say(f"enrolled {row.name}")
    give_outright(service, row.name)
    publish_if_revoked(service)


def _read_code(code: str | None, image: Path | None, csr_file: Path | None) -> qr.Code:
    """The code from exactly one source; with none, ask at the terminal."""
    if sys.stdin.isatty() and (code, image, csr_file) == (None, None, None):
        code = _prompt_for_code()
    match (code, image, csr_file):
        case (str(), None, None):
            found = qr.parse(code)
        case (None, Path(), None):
            found = qr.parse(code_in_file(image, sys.stdin.buffer))
        case (None, None, Path()):
            return qr.Code(sha256(_read(csr_file)).digest())
        case _:
            raise click.UsageError("give a code, or --image, or --csr: one of them")
    found.check_time(now())
    return found


def _prompt_for_code() -> str:
    """Text pasted here needs no quotes, unlike in a shell."""
    try:
        typed: str = click.prompt("the text below the code", err=True)
    except click.Abort as abort:
        reraise_interrupt(abort)
        raise ConfigurationError("no code was given", "paste the line with ROSSEC:") from None
    return typed


def _destination(
    code: qr.Code, given_address: str | None, csr_file: Path | None
) -> Destination | None:
    """Where the node waits; None if files are copied by hand."""
    if given_address is not None or code.address:
        return address.split(given_address or code.address)
    if csr_file is not None:
        return None
    raise ConfigurationError(
        "a label does not say where its node is", "add --address HOST, as the node shows it"
    )


def _fetch_request(
    core: AuthorityEnrollment, csr_file: Path | None, destination: Destination | None
) -> None:
    if csr_file is not None:
        core.receive(write(Delivery(_read(csr_file))), now())
        return
    assert destination is not None  # noqa: S101 - a code without an address was refused
    asyncio.run(fetch(core, *destination, now))


def _source(code: qr.Code, csr_file: Path | None, destination: Destination | None) -> str:
    kind = "a screen code" if code.secret else "a label" if csr_file is None else "a file"
    return kind if destination is None else f"{kind} at {address.join(*destination)}"


def _deliver_identity(core: AuthorityEnrollment, bundle: bytes, destination: Destination) -> None:
    """Offer the identity, and wait for the confirmation at the node."""
    *chain, root = from_pem(bundle)
    offer = core.offer(chain, root, secrets.token_bytes(NONCE_SIZE), now())

    def show(digits: str) -> None:
        say(f"digits {group_digits(digits)}")
        say("the same at the node? then confirm there; if not, stop here and there")

    asyncio.run(deliver(core, offer, *destination, now, show))


def _read(path: Path) -> bytes:
    with path.open("rb") as stream:
        return stream.read(MAX_REQUEST + 1)
