"""`rossec master delegate`: let the master renew grants in place of the authority."""

from typing import Final

import click

from ca.names import is_master_name
from grants.renewal import MAX_DELEGATION, MAX_TICKET, MIN_TICKET
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Duration
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_list, remind_to_publish
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.ros.names import MASTER
from rossec.terminal import record, say

DAY: Final = 86400


@click.command()
@click.option(
    "--for", "lifetime", type=Duration(MAX_DELEGATION // DAY), default="90d", show_default=True,
    help="how long the master may renew grants",
)  # fmt: skip
@click.option(
    "--ticket", type=Duration(MAX_TICKET // DAY), default="8h", show_default=True,
    help="how long a renewed grant holds before it is renewed again; at least a minute",
)  # fmt: skip
@click.option(
    "--to", "master", metavar="NAME", default=MASTER, show_default=True,
    help="which of the domain's masters; give its address with --master",
)  # fmt: skip
@click.option("--withdraw", is_flag=True, help="revoke what was delegated before instead")
@options.master_uri
@json_result()
@pass_service
def delegate(
    service: AuthorityService, lifetime: int, ticket: int, master: str, withdraw: bool
) -> None:
    """Let the master renew grants, unchanged and up to their caps, while the authority is away.

    A revoked grant is not renewed. With --withdraw, what the master has renewed ends at once.
    """
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
        listed, count = service.revoke_delegations("withdrawn")
        record(withdrawn=count, list=listed.seq)
        say(f"withdrew {count} delegation{'s' * (count != 1)} (list {listed.seq})")
        publish_list(service)
        return
    delegation, call = service.delegate(lifetime, ticket, master)
    until = format_time(delegation.expires)
    record(master=master, id=delegation.id.hex(), expires=delegation.expires, published=False)
    say(f"{master} may renew grants until {until} (delegation {delegation.id.hex()})")
    service.deliver_delegation(delegation, call)
    record(published=True)
    say("the master has the delegation")
    remind_to_publish(service)
