"""`rossec grant`: sign, look at and revoke what nodes may do."""

import asyncio
import secrets
from pathlib import Path
from typing import Final

import click

from ca.names import check_name
from grants import document
from grants.filters.presets import PRESETS
from grants.model import Draft
from rossec.authority.home import AuthorityHome
from rossec.cli.grant import permission_options
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Duration, Environment, moment, now, pass_environment
from rossec.cli.shared.delivery import deliver, remind
from rossec.cli.shared.handing_over import hand_over
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.terminal import printable, say, say_json

SKEW: Final = 60  # seconds another host's clock may be behind: it must not find the grant too new
MAX_DAYS: Final = 3650  # an authority's own certificate does not last longer


@click.group()
def grant() -> None:
    """Sign, show and revoke grants."""


@grant.command()
@click.argument("node")
@permission_options.rights
@click.option("--graph", is_flag=True, help="may see the whole ROS graph")
@click.option("--type", "type_name", metavar="PKG/TYPE", help="message type of the restrictions")
@click.option("--clear", multiple=True, metavar="FIELD", help="clear this field")
@click.option("--round", "rounds", multiple=True, metavar="FIELD=STEP", help="round this field")
@click.option(
    "--clamp", "clamps", multiple=True, metavar="FIELD=LOW:HIGH", help="keep this field in a range"
)
@click.option("--rate", type=float, metavar="HZ", help="at most so many messages a second")
@click.option(
    "--preset",
    "preset_name",
    type=click.Choice(list(PRESETS)),
    help="restrictions for a usual wish; see `rossec grant presets`",
)
@click.option(
    "--when",
    multiple=True,
    metavar="CONDITION",
    help="only messages and times for which this holds",
)
@click.option(
    "--for",
    "lifetime",
    type=Duration(MAX_DAYS),
    default="7d",
    show_default=True,
    help="how long it holds",
)
@click.option(
    "--renew-until",
    "renewal",
    type=Duration(MAX_DAYS),
    default=0,
    metavar="DURATION",
    help="how long the master may renew it; see: rossec master delegate",
)
@click.option(
    "--out", type=click.Path(path_type=Path), help="also write the grant to this new file"
)
@passphrase.option
@pass_environment
def sign(
    environment: Environment,
    /,
    node: str,
    graph: bool,
    type_name: str | None,
    clear: tuple[str, ...],
    rounds: tuple[str, ...],
    clamps: tuple[str, ...],
    rate: float | None,
    preset_name: str | None,
    when: tuple[str, ...],
    lifetime: int,
    renewal: int,
    out: Path | None,
    passphrase_file: Path | None,
    **rights: tuple[str, ...],
) -> None:
    """Let NODE publish, subscribe, call and so on, under conditions and through filters.

    PATTERN is a name; * stands for one segment, ** for any depth.
    """
    check_name(node)
    if out is not None:
        _check_new(out)
    filters = permission_options.rules(clear, rounds, clamps)
    restricted = permission_options.restrictions(type_name, filters, when, rate, preset_name)
    permissions = permission_options.permissions(
        permission_options.asked(rights), graph=graph, restricted=restricted
    )
    home = AuthorityHome.at(environment.home)
    holder = home.store().valid_certificate(node, now()).thumbprint
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    signed = now()
    draft = Draft(
        domain=authority.domain, subject=node, holder=holder, not_before=signed - SKEW,
        expires=signed + lifetime, cap=signed + max(lifetime, renewal),
        serial=secrets.token_bytes(16), permissions=permissions,
    )  # fmt: skip
    number = authority.store.next_number()
    data = authority.issue_grant(draft, signed)
    say(f"grant {document.grant_id(data).hex()} for {node} until {moment(draft.expires)}")
    hand_over(environment, node, data, out)
    remind(authority.store, number)


@grant.command()
def presets() -> None:
    """Say what each preset hides, and what is still learnt."""
    for entry in PRESETS.values():
        say(entry.name)
        say(f"  hides {entry.hides}")
        say(f"  still tells {entry.leaves}")


@grant.command("list")
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


@grant.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
def show(file: Path) -> None:
    """Say in words what the grant in FILE allows; its signature is not checked."""
    content = document.peek(_read(file))
    said = printable(f"of {content.domain} for {content.subject}")
    say(f"grant {content.id.hex()} {said}")
    say(f"holds from {moment(content.not_before)} until {moment(content.expires)}")
    for permission in content.permissions:
        say(printable(f"may {permission.rights.label} {permission.pattern}"))
        for line in permission.restriction.lines() if permission.restriction else []:
            say(printable(f"  {line}"))


@grant.command()
@click.argument("file", type=click.Path(path_type=Path, exists=True, dir_okay=False))
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


@grant.command()
@click.argument("grant_id")
@click.option("--reason", default="", help="why, for the record")
@options.master_to_tell
@passphrase.option
@pass_environment
def revoke(
    environment: Environment,
    grant_id: str,
    reason: str,
    master_uri: str | None,
    passphrase_file: Path | None,
) -> None:
    """Revoke the grant GRANT_ID (or the beginning of it) and tell the master at once."""
    home = AuthorityHome.at(environment.home)
    entry = _full_id(home, grant_id)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    listed = authority.revoke(entry, reason, now())
    say(f"revoked {entry.hex()} (list {listed.seq})")
    asyncio.run(deliver(environment, master_uri))
    say("the master has the new list")


def _check_new(out: Path) -> None:
    """Before anything is signed: a grant that cannot be written would exist nevertheless."""
    if out.exists() or out.is_symlink():
        raise ConfigurationError(f"{out} exists and is not overwritten", "give a new file")
    if not out.parent.is_dir():
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")


def _full_id(home: AuthorityHome, beginning: str) -> bytes:
    known = [row.id for row in home.store().grants()]
    found = [entry for entry in known if beginning and entry.hex().startswith(beginning.lower())]
    if len(found) != 1:
        count = "several grants begin" if found else "no grant begins"
        raise ConfigurationError(f"{count} with {beginning!r}", "see: rossec grant list")
    return found[0]


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
    state = "revoked" if content.id in revoked else f"until {moment(content.expires)}"
    return f"{content.id.hex()}  {content.subject}  {rights}  {state}"
