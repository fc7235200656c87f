"""`rossec grant sign | presets`: what nodes may do, signed."""

import contextlib
from pathlib import Path
from typing import Any, Final

import click

from ca.domains.aliases import is_alias, local_name
from ca.names import check_name
from grants import document
from grants.filters.presets import PRESETS
from grants.model import MAX_NARROWINGS
from rossec import files
from rossec.authority.grant_delivery import require_delivered
from rossec.authority.service import AuthorityService
from rossec.cli.grant import permission_options
from rossec.cli.shared import options
from rossec.cli.shared.context import Duration, now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import deliver_grant, pass_service, remind_to_publish
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import record, say

MAX_DAYS: Final = 3650  # an authority's own certificate does not last longer


@click.command()
@click.argument("node")
@permission_options.wishes
@click.option(
    "--for", "lifetime", type=Duration(MAX_DAYS), default="7d", show_default=True,
    help="how long it holds",
)  # fmt: skip
@click.option(
    "--renew-until", "renewal", type=Duration(MAX_DAYS), default=0, metavar="DURATION",
    help="how long the master may renew it; see: rossec master delegate",
)  # fmt: skip
@click.option(
    "--may-narrow", type=click.IntRange(0, MAX_NARROWINGS), default=0, metavar="N",
    help="how often it may be handed on, restricted further; see: rossec grant narrow",
)  # fmt: skip
@click.option(
    "--certificate", type=options.FILE,
    help="the certificate of a node of another domain: its node.pem, without its key",
)  # fmt: skip
@click.option(
    "--out", type=click.Path(path_type=Path), help="also write the grant to this new file"
)
@options.master_uri
@json_result()
@pass_service
def sign(
    service: AuthorityService,
    /,
    node: str,
    lifetime: int,
    renewal: int,
    out: Path | None,
    may_narrow: int,
    certificate: Path | None,
    **wishes: Any,
) -> None:
    """Let NODE publish, subscribe, call and so on, under conditions and through filters.

    The node gets the grant from the master, or from its directory if that is in this ROSSEC_HOME.
    PATTERN is a name; * stands for one segment, ** for any depth, '{node}' for NODE's own name.

    NODE may be one of another domain, as hospital:/rounds/robot3: its key is that of CERTIFICATE,
    verified below that domain's listed root, and the grant is a file that somebody carries there.
    """
    name = check_name(local_name(node))
    _check_foreign(node, renewal, out, certificate, foreign=is_alias(name))
    if out is not None:
        check_new(out)
    wanted = permission_options.for_node(wishes, name, lambda: _has_tail(service, name))
    permissions = permission_options.read(wanted)
    pem = b"" if certificate is None else files.read(certificate, options.MAX_PEM)
    draft, data = service.sign_grant(name, permissions, lifetime, renewal, may_narrow, pem)
    record(id=document.grant_id(data).hex(), node=name, expires=draft.expires)
    say(f"grant {document.grant_id(data).hex()} for {node} until {format_time(draft.expires)}")
    refused = deliver_grant(service, data, out)
    remind_to_publish(service)
    require_delivered(refused)


@click.command()
@json_result()
def presets() -> None:
    """Show what each preset hides, and what it still discloses."""
    record(
        presets=[
            {"name": entry.name, "hides": entry.hides, "discloses": entry.reveals}
            for entry in PRESETS.values()
        ]
    )
    for entry in PRESETS.values():
        say(entry.name)
        say(f"  hides {entry.hides}")
        say(f"  still discloses {entry.reveals}")


def _has_tail(service: AuthorityService, name: str) -> bool:
    """Whether the newest identity of a node of this domain is for anonymous nodes too."""
    with contextlib.closing(service.home.store()) as store:
        return not is_alias(name) and store.valid_certificate(name, now()).wildcard


def _check_foreign(
    node: str, renewal: int, out: Path | None, certificate: Path | None, *, foreign: bool
) -> None:
    """What differs for a node of another domain, before anything is signed."""
    if not foreign:
        if certificate is not None:
            raise ConfigurationError(
                f"{node} is a node of this domain, whose key is in the record",
                "--certificate is for nodes of other domains: LABEL:/NAME",
            )
    elif renewal:
        raise ConfigurationError(
            "a grant for another domain is not renewed: its nodes ask another master",
            "give the whole time: --for",
        )
    elif out is None:
        raise ConfigurationError(
            f"no master of this domain delivers to {node}", "give --out FILE, and carry it there"
        )


def check_new(out: Path) -> None:
    """Before anything is signed: a grant that cannot be written would exist nevertheless."""
    if out.exists() or out.is_symlink():
        raise ConfigurationError(f"{out} exists and is not overwritten", "give a new file")
    if not out.parent.is_dir():
        raise ConfigurationError(f"there is no directory {out.parent}", "make it first")
