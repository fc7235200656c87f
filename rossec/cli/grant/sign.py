"""`rossec grant sign | presets`: what nodes may do, signed."""

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
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Duration, Environment, format_time, now, pass_environment
from rossec.cli.shared.delivery import remind_to_publish
from rossec.cli.shared.grant_delivery import deliver_grant
from rossec.errors import ConfigurationError
from rossec.terminal import say

SKEW: Final = 60  # seconds another host's clock may be behind: it must not find the grant too new


MAX_DAYS: Final = 3650  # an authority's own certificate does not last longer


@click.command()
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
        permission_options.patterns_by_right(rights), graph=graph, restricted=restricted
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
    say(f"grant {document.grant_id(data).hex()} for {node} until {format_time(draft.expires)}")
    deliver_grant(environment, node, data, out)
    remind_to_publish(authority.store, number)


@click.command()
def presets() -> None:
    """Show what each preset hides, and what it still discloses."""
    for entry in PRESETS.values():
        say(entry.name)
        say(f"  hides {entry.hides}")
        say(f"  still discloses {entry.reveals}")


def _check_new(out: Path) -> None:
    """Before anything is signed: a grant that cannot be written would exist nevertheless."""
    if out.exists() or out.is_symlink():
        raise ConfigurationError(f"{out} exists and is not overwritten", "give a new file")
    if not out.parent.is_dir():
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")
