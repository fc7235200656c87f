"""`rossec grant list | deliver`: the grants that were signed, and whether their nodes have them."""

from collections.abc import Mapping

import click

from ca.domains.aliases import is_alias, shown
from grants import document
from grants.model import Grant
from rossec import terminal
from rossec.authority.grant_delivery import require_delivered
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import say_deposited, service_of
from rossec.clock import format_time
from rossec.errors import ConfigurationError, NotDelivered
from rossec.home import NodeHome
from rossec.terminal import note, say, say_json

_OVER = ("expired", "revoked")
_STATES = {"held": "held", "fetched": "delivered", "waiting": "waiting", "": "undelivered"}


@click.command("list")
@click.argument("nodes", metavar="[NODE]...", nargs=-1)
@click.option("--json", "as_json", is_flag=True, help="one line of JSON")
@options.master_uri
@pass_environment
def list_(
    environment: Environment, nodes: tuple[str, ...], as_json: bool, master_uri: str | None
) -> None:
    """List the grants signed here, of one NODE or of all, and how far each has come.

    In order of nodes; what is in force first, and of it what ends last. Each line ends with when
    the grant ends, and its state. held: the node has presented it to the master. delivered: it was
    sent to the node, or is in its directory here. waiting: the master has it, the node was not
    there yet. undelivered: see `rossec grant deliver`. unknown: the master does not answer.
    expired, revoked: it holds no longer.
    """
    service = service_of(environment, master_uri=master_uri)
    store = service.home.store()
    grants = [document.peek(row.data) for row in store.grants() if not nodes or row.name in nodes]
    revoked = store.revoked_entries()
    states = {grant.id: _ended(grant, revoked) for grant in grants}
    if not all(states.values()):
        _complete(service, grants, states)
    grants.sort(key=lambda grant: _place(grant, states[grant.id]))
    if as_json:
        say_json([_summary(grant, revoked, states[grant.id]) for grant in grants])
        return
    for grant in grants:
        say(_line(grant, states[grant.id]))


@click.command()
@options.master_uri
@json_result()
@pass_environment
def deliver(environment: Environment, master_uri: str | None) -> None:
    """Deposit every grant in force that the master does not have.

    Nodes fetch theirs from it, those that run at once.
    """
    service = service_of(environment, master_uri=master_uri)
    count, refused = service.deposit_missing()
    say_deposited(count, refused)
    if not count and not refused:
        say("the master has every grant in force")
    require_delivered(refused)


def _place(grant: Grant, state: str) -> tuple[object, ...]:
    """Own nodes before those of other domains, grants in force before others, the newest first."""
    foreign = is_alias(grant.subject)
    return foreign, grant.subject, state in _OVER, -grant.expires, -grant.not_before, grant.id


def _ended(grant: Grant, revoked: frozenset[bytes]) -> str:
    """`revoked`, `expired`, or empty: in force."""
    if not revoked.isdisjoint((grant.id, grant.holder)):
        return "revoked"
    return "expired" if now() >= grant.cap else ""


def _complete(service: AuthorityService, grants: list[Grant], states: dict[bytes, str]) -> None:
    """Fill in the states of the grants in force: what the master says, and what is here."""
    answered, reason = _ask_master(service)
    for grant in grants:
        if states[grant.id]:
            continue
        states[grant.id] = _STATES.get(answered.get(grant.id, "?"), "unknown")
        here = NodeHome.of(service.rossec_home, grant.subject).grant_file(grant.id).exists()
        if here and states[grant.id] != "held":
            states[grant.id] = "delivered"
    if reason and "unknown" in states.values():
        note(f"whether nodes have their grants is unknown: {reason}")


def _ask_master(service: AuthorityService) -> tuple[Mapping[bytes, str], str]:
    """What the master says of the grants in force, or nothing, and why."""
    try:
        return service.delivery_states(), ""
    except (NotDelivered, ConfigurationError) as error:
        return {}, str(error)


def _summary(grant: Grant, revoked: frozenset[bytes], state: str) -> dict[str, object]:
    return {
        "id": grant.id.hex(),
        "node": grant.subject,
        "not_before": grant.not_before,
        "expires": grant.expires,
        "revoked": grant.id in revoked,
        "state": state,
        "permissions": permissions_json(grant),
    }


def permissions_json(grant: Grant) -> list[dict[str, object]]:
    """The permissions of a grant for programs."""
    return [
        {
            "rights": item.rights.label,
            "pattern": item.pattern,
            "restrictions": item.restriction.lines() if item.restriction else [],
        }
        for item in grant.permissions
    ]


def _line(grant: Grant, state: str) -> str:
    given = (f"{item.rights.label} {item.pattern}" for item in grant.permissions)
    rights = "; ".join(dict.fromkeys(given))  # a right may have several restrictions
    end = f"until {format_time(grant.expires)}"
    return f"{grant.id.hex()}  {shown(grant.subject)}  {rights}  {end}  {terminal.state(state)}"
