"""`rossec grant show | install | revoke`: one grant that was signed."""

from pathlib import Path

import click

from grants import document
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.service import pass_service, publish_list
from rossec.clock import format_time
from rossec.home import NodeHome
from rossec.terminal import printable, say


@click.command()
@click.argument("file", type=options.FILE)
def show(file: Path) -> None:
    """Show what the grant in FILE allows; its signature is not checked."""
    content = document.peek(_read(file))
    holder = printable(f"of {content.domain} for {content.subject}")
    say(f"grant {content.id.hex()} {holder}")
    say(f"holds from {format_time(content.not_before)} until {format_time(content.expires)}")
    for permission in content.permissions:
        say(printable(f"may {permission.rights.label} {permission.pattern}"))
        for line in permission.restriction.lines() if permission.restriction else []:
            say(printable(f"  {line}"))


@click.command()
@click.argument("file", type=options.FILE)
@pass_environment
def install(environment: Environment, file: Path) -> None:
    """Give the grant in FILE to its node, on the node's machine."""
    data = _read(file)
    content = document.peek(data)
    home = NodeHome.of(environment.home, content.subject)
    anchor = home.anchor()
    document.open_grant(data, anchor.public_key, now(), domain=anchor.domain)
    home.add_grant(document.grant_id(data), data)
    say(f"{content.subject} holds grant {content.id.hex()}")


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


def _read(file: Path) -> bytes:
    with file.open("rb") as stream:
        return stream.read(64 * 1024)
