"""`rossec grant list | deliver | show | install | revoke`, `rossec master delegate`: signed grants."""

from pathlib import Path
from typing import Final

import click

from ca.names import is_alias, is_master_name, shown
from grants import document
from grants.model import Grant
from grants.renewal import MAX_DELEGATION, MAX_TICKET, MIN_TICKET
from grants.token import peek
from rossec import clock, terminal
from rossec.authority.grant_operations import require_delivered
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import holder_home, open_held, read_token
from rossec.cli.shared.options import FILE, Batch, duration, flag, json_result, option, say_result, unique
from rossec.cli.shared.service import pass_service, publish_list, remind_to_publish, say_deposited, service_of
from rossec.errors import ConfigurationError, NotDelivered
from rossec.home import NodeHome
from rossec.ros.names import MASTER
from rossec.terminal import note, printable, record, say

_STATES = {"held": "held", "fetched": "delivered", "waiting": "waiting", "": "undelivered"}
DAY: Final = 86400


@click.command("list")
@click.argument("nodes", metavar="[NODE]...", nargs=-1)
@options.as_json
@options.master_uri
@pass_environment
def list_(environment: Environment, nodes: tuple[str, ...], as_json: bool, master_uri: str | None) -> None:
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
    at = now()
    states = {
        grant.id: "revoked"
        if not revoked.isdisjoint((grant.id, grant.holder))
        else "expired" * (at >= grant.cap)
        for grant in grants
    }
    # The master is asked only where the record does not say it: a list works without a master.
    if not all(states.values()):
        _complete(service, grants, states)

    def place(grant: Grant) -> tuple[object, ...]:
        over = states[grant.id] in ("expired", "revoked")
        return is_alias(grant.subject), grant.subject, over, -grant.expires, -grant.not_before, grant.id

    grants.sort(key=place)
    rows = [(grant, states[grant.id]) for grant in grants]
    documents = [_summary(grant, revoked, state) for grant, state in rows]
    say_result(as_json, documents, (_line(grant, state) for grant, state in rows))


def _complete(service: AuthorityService, grants: list[Grant], states: dict[bytes, str]) -> None:
    answered, reason = dict[bytes, str](), ""
    try:
        answered = dict(service.grants.delivery_states())
    except (NotDelivered, ConfigurationError) as error:
        reason = str(error)
    for grant in grants:
        if states[grant.id]:
            continue
        states[grant.id] = _STATES.get(answered.get(grant.id, "?"), "unknown")
        here = NodeHome.of(service.rossec_home, grant.subject).grant_file(grant.id).exists()
        if here and states[grant.id] != "held":
            states[grant.id] = "delivered"
    if reason and "unknown" in states.values():
        note(f"whether nodes have their grants is unknown: {reason}")


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
    return [
        {"rights": item.rights.label, "pattern": item.pattern, "restrictions": item.lines()}
        for item in grant.permissions
    ]


def _line(grant: Grant, state: str) -> str:
    rights = "; ".join(dict.fromkeys(map(str, grant.permissions)))  # a right may have several restrictions
    end = f"until {clock.format_time(grant.expires)}"
    return f"{grant.id.hex()}  {shown(grant.subject)}  {rights}  {end}  {terminal.state(state)}"


@click.command()
@options.master_uri
@json_result(pass_environment)
def deliver(environment: Environment, master_uri: str | None) -> None:
    """Deposit every grant in force that the master does not have.

    Nodes fetch theirs from it, those that run at once.
    """
    service = service_of(environment, master_uri=master_uri)
    count, refused = service.grants.deposit_missing()
    say_deposited(count, refused)
    if not count and not refused:
        say("the master has every grant in force")
    require_delivered(refused)


@click.command()
@click.argument("file", type=FILE)
@json_result()
def show(file: Path) -> None:
    """Show what the grant in FILE allows; its signature is not checked."""
    content = peek(read_token(file))
    record(**_facts(content))
    holder = printable(f"of {content.domain} for {content.subject}")
    say(f"grant {content.id.hex()} {holder}")
    say(f"holds from {clock.format_time(content.not_before)} until {clock.format_time(content.expires)}")
    for depth, link in enumerate(content.links):
        if content.chain:
            to = printable(link.subject)
            say(f"narrowed for {to}, which may also not do more than:" if depth else f"for {to}:")
        for permission in link.permissions:
            say(printable(f"may {permission}"))
            for line in permission.lines():
                say(printable(f"  {line}"))
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
        "links": [{"node": link.subject, "permissions": permissions_json(link)} for link in content.links],
    }


@click.command()
@click.argument("grant_files", metavar="FILE...", nargs=-1, required=True, type=FILE)
@json_result(pass_environment)
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
            say(f"{home.name} holds grant {content.id.hex()}", grant=content.id.hex(), node=home.name)
    batch.finish()


@click.command()
@click.argument("grant_ids", metavar="GRANT_ID...", nargs=-1, required=True)
@options.reason
@options.master_uri
@json_result(pass_service)
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
            listed, entry = service.grants.revoke(grant_id, reason)
            say(f"revoked {entry.hex()} (list {listed.seq})", grant=entry.hex(), list=listed.seq)
    if batch.done:
        publish_list(service)
    batch.finish()


@click.command()
@duration("--for lifetime", "how long the master may renew grants", days=MAX_DELEGATION // DAY, default="90d")
@duration(
    "--ticket",
    "how long a renewed grant holds before it is renewed again; at least a minute",
    days=MAX_TICKET // DAY,
    default="8h",
)
@option(
    "--to=NAME master",
    "which of the domain's masters; give its address with --master",
    default=MASTER,
    show_default=True,
)
@flag("--withdraw", "revoke what was delegated before instead")
@options.master_uri
@json_result(pass_service)
def delegate(service: AuthorityService, lifetime: int, ticket: int, master: str, withdraw: bool) -> None:
    """Let the master renew grants, unchanged and up to their caps, while the authority is away.

    A revoked grant is not renewed. With --withdraw, what the master has renewed ends at once.
    """
    # Before a passphrase is asked for.
    if ticket < MIN_TICKET:
        raise ConfigurationError(
            f"a ticket of {ticket} s ends before a node can be sure to have the next one",
            f"give {MIN_TICKET}s or more: a node renews after two thirds, the rest is for retries",
        )
    if not is_master_name(master):
        raise ConfigurationError(
            f"{master[:255]!a} is not the name of a master", "/master, or /master/kitchen"
        )
    if withdraw:
        listed, count = service.grants.revoke_delegations("withdrawn")
        record(withdrawn=count, list=listed.seq)
        say(f"withdrew {count} delegation{'s' * (count != 1)} (list {listed.seq})")
        publish_list(service)
        return
    delegation, call = service.grants.delegate(lifetime, ticket, master)
    until = clock.format_time(delegation.expires)
    # Signed and recorded before it is delivered: it can be withdrawn also if the master never answers.
    record(master=master, id=delegation.id.hex(), expires=delegation.expires, published=False)
    say(f"{master} may renew grants until {until} (delegation {delegation.id.hex()})")
    service.grants.deliver_delegation(delegation, call)
    say("the master has the delegation", published=True)
    remind_to_publish(service)
