"""`rossec grant`: sign, look at and revoke what nodes may do."""

import asyncio
import secrets
from pathlib import Path
from typing import Final

import click

from ca.names import check_name
from grants import document
from grants.conditions import compile_condition
from grants.errors import ConditionRefused, FilterRefused
from grants.filters import compile_filter
from grants.layout import parse
from grants.model import Draft, Permission, Restriction, Right, filter_rules
from grants.presets import PRESETS, preset
from rossec.authority import AuthorityHome
from rossec.cli import passphrase
from rossec.cli.context import Duration, Environment, moment, now, pass_environment
from rossec.cli.publish import deliver, remind
from rossec.cli.voice import note, printable, say, say_json
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.node.messages import message_type

SKEW: Final = 60  # seconds another host's clock may be behind: it must not find the grant too new
MAX_DAYS: Final = 3650  # an authority's own certificate does not last longer
_EXAMPLES: Final = (
    "for example --clear header.frame_id, --round pose.position=2.0,"
    " --when 'msg.header.frame_id == \"map\"'"
)


@click.group()
def grant() -> None:
    """Sign, show and revoke grants."""


@grant.command()
@click.argument("node")
@click.option("--publish", multiple=True, metavar="PATTERN", help="may publish these topics")
@click.option("--subscribe", multiple=True, metavar="PATTERN", help="may subscribe to these topics")
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
    node: str,
    publish: tuple[str, ...],
    subscribe: tuple[str, ...],
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
) -> None:
    """Let NODE publish or subscribe, under conditions and through filters.

    PATTERN is a topic name; * stands for one segment, ** for any depth.
    """
    check_name(node)
    if out is not None:
        _check_new(out)
    restrictions = _restrictions(type_name, _rules(clear, rounds, clamps), when, rate, preset_name)
    permissions = _permissions(publish, subscribe, graph, restrictions)
    home = AuthorityHome.at(environment.home)
    holder = home.store().live_certificate(node, now()).thumbprint
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    signed = now()
    draft = Draft(
        domain=authority.domain, subject=node, holder=holder, not_before=signed - SKEW,
        expires=signed + lifetime, cap=signed + max(lifetime, renewal),
        serial=secrets.token_bytes(16), permissions=permissions,
    )  # fmt: skip
    number = authority.store.next_number()
    data = authority.grant(draft, signed)
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
@click.option("--master", "master_uri", help="master to tell, instead of ROS_MASTER_URI")
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


def _rules(
    clear: tuple[str, ...], rounds: tuple[str, ...], clamps: tuple[str, ...]
) -> dict[str, dict[str, object]]:
    rules: dict[str, dict[str, object]] = {path: {"clear": True} for path in clear}
    rules |= {path: {"round": {"step": step}} for path, step in map(_rounding, rounds)}
    return rules | {
        path: {"clamp": {"low": low, "high": high}} for path, low, high in map(_clamping, clamps)
    }


def _restrictions(
    type_name: str | None,
    rules: dict[str, dict[str, object]],
    when: tuple[str, ...],
    rate: float | None,
    preset_name: str | None,
) -> list[Restriction]:
    """Build the restrictions and try them on the message type: mistakes show here, not later."""
    if not rules and not when and rate is None and preset_name is None:
        return []
    if type_name is None:
        raise ConfigurationError(
            "restrictions need the message type they are for", "add --type PKG/TYPE"
        )
    shape = parse(type_name, message_type(type_name).definition)
    try:
        made = [preset(preset_name).restriction(shape)] if preset_name is not None else []
        if rules or when or rate is not None:
            made.append(Restriction(type_name, when, filter_rules(rules), rate))
        for restriction in made:
            compile_filter(shape, restriction.filters)
            for text in restriction.conditions:
                compile_condition(shape, text)
    except (ConditionRefused, FilterRefused) as error:
        error.hint = error.hint or _EXAMPLES
        raise
    return made


def _permissions(
    publish: tuple[str, ...],
    subscribe: tuple[str, ...],
    graph: bool,
    restrictions: list[Restriction],
) -> tuple[Permission, ...]:
    made = [Permission(pattern, Right.PUBLISH) for pattern in publish]
    for pattern in subscribe:  # all restrictions that cover a topic hold together
        made += [Permission(pattern, Right.SUBSCRIBE, item) for item in restrictions]
        if not restrictions:
            made.append(Permission(pattern, Right.SUBSCRIBE))
    if graph:
        made.append(Permission("/**", Right.GRAPH))
    if not made:
        raise ConfigurationError(
            "a grant that allows nothing", "add --publish, --subscribe or --graph"
        )
    if restrictions and not subscribe:
        raise ConfigurationError(
            "conditions and filters restrict what a subscriber sees", "add --subscribe"
        )
    return tuple(made)


def _clamping(text: str) -> tuple[str, float, float]:
    path, _, limits = text.partition("=")
    low, _, high = limits.partition(":")
    try:
        return path, _number(low), _number(high)
    except ValueError:
        raise ConfigurationError(
            f"--clamp {text} has no range", "for example --clamp ranges=0.5:10"
        ) from None


def _number(text: str) -> float:
    """Whole where it is written so: fields of whole numbers take no other."""
    try:
        return int(text)
    except ValueError:
        return float(text)


def _rounding(text: str) -> tuple[str, float]:
    path, _, step = text.partition("=")
    try:
        return path, float(step)
    except ValueError:
        raise ConfigurationError(
            f"--round {text} has no step", "for example --round pose.position=2.0"
        ) from None


def _check_new(out: Path) -> None:
    """Before anything is signed: a grant that cannot be written would exist nevertheless."""
    if out.exists() or out.is_symlink():
        raise ConfigurationError(f"{out} exists and is not overwritten", "give a new file")
    if not out.parent.is_dir():
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")


def hand_over(environment: Environment, node: str, data: bytes, out: Path | None) -> None:
    """Give a grant to its node: into its directory when it lives here, and into a file."""
    if out is not None:
        with out.open("xb") as file:
            file.write(data)
        say(f"written to {out}")
    home = NodeHome.of(environment.home, node)
    if home.path.is_dir():
        home.add_grant(document.grant_id(data), data)
        say(f"given to {node} in {home.path}")
    elif out is None:
        note(
            f"{node} lives elsewhere: sign with --out FILE, then `rossec grant install FILE` there"
        )


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
