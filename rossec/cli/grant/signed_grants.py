"""`rossec grant show | install | revoke`: one grant that was signed."""

from pathlib import Path

import click

from grants.model import Grant
from grants.token import peek
from rossec.authority.service import AuthorityService
from rossec.cli.grant.delivery import permissions_json
from rossec.cli.shared import options
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_list
from rossec.cli.shared.tokens import holder_home, open_held, read_token
from rossec.clock import format_time
from rossec.terminal import printable, record, say


@click.command()
@click.argument("file", type=options.FILE)
@json_result()
def show(file: Path) -> None:
    """Show what the grant in FILE allows; its signature is not checked."""
    content = peek(read_token(file))
    record(**_facts(content))
    holder = printable(f"of {content.domain} for {content.subject}")
    say(f"grant {content.id.hex()} {holder}")
    say(f"holds from {format_time(content.not_before)} until {format_time(content.expires)}")
    for depth, link in enumerate(content.links):
        if content.chain:
            to = printable(link.subject)
            say(f"narrowed for {to}, which may also not do more than:" if depth else f"for {to}:")
        _show_permissions(link)
    if content.may_narrow:
        say(f"may be narrowed {content.may_narrow} times")


def _facts(content: Grant) -> dict[str, object]:
    return {
        "id": content.id.hex(),
        "domain": content.domain,
        "node": content.subject,
        "not_before": content.not_before,
        "expires": content.expires,
        "may_narrow": content.may_narrow,
        "links": [
            {"node": link.subject, "permissions": permissions_json(link)} for link in content.links
        ],
    }


def _show_permissions(link: Grant) -> None:
    for permission in link.permissions:
        say(printable(f"may {permission.rights.label} {permission.pattern}"))
        for line in permission.restriction.lines() if permission.restriction else []:
            say(printable(f"  {line}"))


@click.command()
@click.argument("grant_files", metavar="FILE...", nargs=-1, required=True, type=options.FILE)
@json_result()
@pass_environment
def install(environment: Environment, grant_files: tuple[Path, ...]) -> None:
    """Give the grant in FILE, or the chain, to its node, on the node's machine.

    Where one of several is refused the others are installed, and the exit code is 1.
    """
    batch = Batch(len(grant_files))
    for file in grant_files:
        with batch.item(file):
            data = read_token(file)
            home = holder_home(environment.home, peek(data))
            content = open_held(home, data, now())
            home.add_grant(content.id, data)
            record(grant=content.id.hex(), node=home.name)
            say(f"{home.name} holds grant {content.id.hex()}")
    batch.finish()


@click.command()
@click.argument("grant_ids", metavar="GRANT_ID...", nargs=-1, required=True)
@click.option("--reason", default="", help="why, for the record")
@options.master_uri
@json_result()
@pass_service
def revoke(service: AuthorityService, grant_ids: tuple[str, ...], reason: str) -> None:
    """Revoke the grant GRANT_ID (or the beginning of it) and notify the master at once.

    Where one of several is refused the others are revoked, and the exit code is 1.
    """
    ids = unique(grant_ids)
    if len(ids) > 1:
        service.unlock()  # a wrong passphrase is no fault of a grant
    batch = Batch(len(ids), "id")
    for grant_id in ids:
        with batch.item(grant_id):
            listed, entry = service.revoke_grant(grant_id, reason)
            record(grant=entry.hex(), list=listed.seq)
            say(f"revoked {entry.hex()} (list {listed.seq})")
    if batch.done:
        publish_list(service)
    batch.finish()
