"""`rossec domain limit | remove`: trust a domain differently, or no more."""

from contextlib import closing
from typing import Any

import click

from rossec.authority.domain_operations import living_grants
from rossec.authority.service import AuthorityService
from rossec.cli.domain import terms
from rossec.cli.domain.delivery import publish_domains
from rossec.cli.shared import options
from rossec.cli.shared.context import confirm, now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_list
from rossec.errors import ConfigurationError
from rossec.terminal import note, printable, record, say


@click.command()
@click.argument("label")
@terms.admit
@terms.fresh(None)
@terms.lifetime(None)
@terms.rules
@options.master_uri
@click.option("--yes", is_flag=True, help="do not ask")
@json_result()
@pass_service
def limit(
    service: AuthorityService,
    label: str,
    admit: tuple[str, ...],
    fresh: int | None,
    lifetime: int | None,
    exported: tuple[str, ...],
    imported: tuple[str, ...],
    yes: bool,
) -> None:
    """Change how far, and until when, the domain LABEL is trusted.

    What is not given stays as it is. A RULE is a pattern and rights, as in '/robot/** subscribe';
    the rules given replace those of before; `everything` is whatever grants allow. Where the
    admitted names change, the domain's connections are cut and made anew.
    """
    changes: dict[str, Any] = {}
    if admit:
        changes["admitted"] = terms.admitted(admit)
    if fresh is not None:
        changes["fresh"] = terms.check_fresh(fresh)
    if lifetime is not None:
        changes["until"] = now() + lifetime
    if exported:
        changes["exported"] = terms.read_rules(exported)
    if imported:
        changes["imported"] = terms.read_rules(imported)
    if not changes:
        raise ConfigurationError(
            "nothing is changed", "--admit, --fresh, --for, --export, --import"
        )
    new = service.changed_domain(label, **changes)
    say(f"domain {new.domain}, here {label}")
    for line in terms.lines(new):
        say(printable(line))
    confirm("trust it so far?", yes=yes)
    listed = service.limit_domain(label, **changes)
    record(**terms.as_json(new), list=listed.seq)
    say(f"changed (list of domains {listed.seq})")
    publish_domains(service)


@click.command()
@click.argument("label")
@click.option("--reason", default="", help="why, for the record")
@click.option(
    "--revoke-grants", is_flag=True, help="also revoke every grant that was signed for its nodes"
)
@options.master_uri
@json_result()
@pass_service
def remove(service: AuthorityService, label: str, reason: str, revoke_grants: bool) -> None:
    """Trust the domain LABEL no more, and cut its connections.

    The other side goes on trusting this one until it removes it as well.
    """
    removed = service.remove_domain(label, reason, revoke_grants=revoke_grants)
    record(domain=removed.row.domain, label=label, revoked=len(removed.revoked))
    say(f"{removed.row.domain} is not trusted any more, nor called {label}")
    if removed.revoked:
        say(f"revoked {len(removed.revoked)} grants for its nodes")
    else:
        _note_grants(service, label)
    note("there you may be trusted still: at its authority, rossec domain remove LABEL")
    if removed.revoked:
        publish_list(service)
    else:
        publish_domains(service)


def _note_grants(service: AuthorityService, label: str) -> None:
    with closing(service.home.store()) as store:
        count = len(living_grants(store, label, now()))
    if count:
        note(f"{count} grants for its nodes would hold again if it is accepted as {label}")
        note("revoke those you do not want: rossec grant list, rossec grant revoke ID")
