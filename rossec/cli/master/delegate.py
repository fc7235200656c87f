"""`rossec master delegate`: let the master renew grants in place of the authority."""

import asyncio
from pathlib import Path
from typing import Final

import click

from grants.renewal import MAX_DELEGATION, MAX_TICKET, MIN_TICKET, open_delegation
from rossec.authority.home import AuthorityHome
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Duration, Environment, format_time, now, pass_environment
from rossec.cli.shared.delivery import deliver_statement, publish_list, remind_to_publish
from rossec.errors import ConfigurationError
from rossec.ros.names import MASTER
from rossec.terminal import say

DAY: Final = 86400
_HINT: Final = "it is signed and stored in {}; start the master and run this again"


@click.command()
@click.option(
    "--for",
    "lifetime",
    type=Duration(MAX_DELEGATION // DAY),
    default="90d",
    show_default=True,
    help="how long the master may renew grants",
)
@click.option(
    "--ticket",
    type=Duration(MAX_TICKET // DAY),
    default="8h",
    show_default=True,
    help="how long a renewed grant holds before it is renewed again; at least a minute",
)
@click.option("--withdraw", is_flag=True, help="revoke what was delegated before instead")
@click.option("--master", "master_uri", help="master to notify, instead of ROS_MASTER_URI")
@passphrase.option
@pass_environment
def delegate(
    environment: Environment,
    lifetime: int,
    ticket: int,
    withdraw: bool,
    master_uri: str | None,
    passphrase_file: Path | None,
) -> None:
    """Let the master renew grants, unchanged and up to their caps, while the authority is away.

    A revoked grant is not renewed. With --withdraw, what the master has renewed ends at once.
    """
    if ticket < MIN_TICKET:
        raise ConfigurationError(
            f"a ticket of {ticket} s ends before a node can be sure to have the next one",
            f"give {MIN_TICKET}s or more: a node renews after two thirds, the rest is for retries",
        )
    home = AuthorityHome.at(environment.home)
    store = home.store()
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    if withdraw:
        listed, count = authority.revoke_delegations("withdrawn", now())
        say(f"withdrew {count} delegation{'s' * (count != 1)} (list {listed.seq})")
        publish_list(environment, master_uri)
        return
    number = authority.store.next_number()
    data = authority.issue_delegation(
        store.valid_certificate(MASTER, now()).thumbprint, lifetime, ticket, now()
    )
    opened = open_delegation(data, authority.signer.public_key)
    until = format_time(opened.expires)
    say(f"{MASTER} may renew grants until {until} (delegation {opened.id.hex()})")
    hint = _HINT.format(home.path / "delegations")
    given = deliver_statement(
        environment, master_uri, "rossec.updateDelegation", (data,), "it", hint
    )
    asyncio.run(given)
    say("the master has the delegation")
    remind_to_publish(authority.store, number)
