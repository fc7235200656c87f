"""`rossec grant list | show | install | revoke`: the grants that were signed."""

from pathlib import Path

import click

from grants import document
from rossec.authority.home import AuthorityHome
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.service import pass_service, publish_list
from rossec.clock import format_time
from rossec.home import NodeHome
from rossec.terminal import printable, say, say_json


@click.command("list")
@click.argument("node", required=False)
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@pass_environment
def list_(environment: Environment, node: str | None, as_json: bool) -> None:
    """List the grants signed here, of one NODE or of all."""
    store = AuthorityHome.at(environment.home).store()
    rows = [row for row in store.grants() if node in (None, row.name)]
    revoked = store.revoked_entries()
    if as_json:
        say_json([_summary(row.data, revoked) for row in rows])
        return
    for row in rows:
        say(_line(row.data, revoked))


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


def _summary(data: bytes, revoked: frozenset[bytes]) -> dict[str, object]:
    content = document.peek(data)
    return {
        "id": content.id.hex(),
        "node": content.subject,
        "not_before": content.not_before,
        "expires": content.expires,
        "revoked": content.id in revoked,
        "permissions": [
            {
                "rights": item.rights.label,
                "pattern": item.pattern,
                "restrictions": item.restriction.lines() if item.restriction else [],
            }
            for item in content.permissions
        ],
    }


def _line(data: bytes, revoked: frozenset[bytes]) -> str:
    content = document.peek(data)
    rights = "; ".join(f"{item.rights.label} {item.pattern}" for item in content.permissions)
    state = "revoked" if content.id in revoked else f"until {format_time(content.expires)}"
    return f"{content.id.hex()}  {content.subject}  {rights}  {state}"
