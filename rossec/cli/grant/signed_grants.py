"""`rossec grant show | install | revoke`: one grant that was signed."""

from pathlib import Path

import click

from grants.model import Grant
from grants.token import peek
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.service import pass_service, publish_list
from rossec.cli.shared.tokens import holder_home, open_held, read_token
from rossec.clock import format_time
from rossec.terminal import printable, say


@click.command()
@click.argument("file", type=options.FILE)
def show(file: Path) -> None:
    """Show what the grant in FILE allows; its signature is not checked."""
    content = peek(read_token(file))
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


def _show_permissions(link: Grant) -> None:
    for permission in link.permissions:
        say(printable(f"may {permission.rights.label} {permission.pattern}"))
        for line in permission.restriction.lines() if permission.restriction else []:
            say(printable(f"  {line}"))


@click.command()
@click.argument("file", type=options.FILE)
@pass_environment
def install(environment: Environment, file: Path) -> None:
    """Give the grant in FILE, or the chain, to its node, on the node's machine."""
    data = read_token(file)
    home = holder_home(environment.home, peek(data))
    content = open_held(home, data, now())
    home.add_grant(content.id, data)
    say(f"{home.name} holds grant {content.id.hex()}")


@click.command()
@click.argument("grant_id")
@click.option("--reason", default="", help="why, for the record")
@options.master_uri
@pass_service
def revoke(service: AuthorityService, grant_id: str, reason: str) -> None:
    """Revoke the grant GRANT_ID (or the beginning of it) and notify the master at once."""
    listed, entry = service.revoke_grant(grant_id, reason)
    say(f"revoked {entry.hex()} (list {listed.seq})")
    publish_list(service)
