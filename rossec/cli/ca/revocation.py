"""`rossec ca revoke | refresh | publish`: revoke identities, sign the list, deliver it."""

import asyncio
from pathlib import Path

import click

from rossec.authority.home import AuthorityHome
from rossec.authority.renewals import own_node_is_due, renew_own_node
from rossec.authority.signing import OWN_NODE
from rossec.cli.shared import options, passphrase
from rossec.cli.shared.context import Environment, format_time, now, pass_environment
from rossec.cli.shared.delivery import deliver, publish_list
from rossec.terminal import note, say


@click.command()
@options.master_uri
@passphrase.option
@pass_environment
def publish(environment: Environment, master_uri: str | None, passphrase_file: Path | None) -> None:
    """Give the newest revocation list to the master.

    The passphrase is needed only where something is revoked that is in no signed list yet.
    """
    home = AuthorityHome.at(environment.home)
    if count := home.count_unlisted(now()):
        note(f"{count} revocation{'s' * (count != 1)} in no signed list yet: it is signed anew")
        home.unlock(passphrase.read(passphrase_file, environment.variables)).refresh_list(now())
    asyncio.run(deliver(environment, master_uri))
    say("the master has the newest list")


@click.command()
@options.master_uri
@passphrase.option
@pass_environment
def refresh(environment: Environment, master_uri: str | None, passphrase_file: Path | None) -> None:
    """Sign the revocation list anew, before it expires, and give it to the master.

    The authority's own node is renewed as well when two thirds of its life are over.
    """
    home = AuthorityHome.at(environment.home)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    if own_node_is_due(authority, now()):
        say(f"renewed {OWN_NODE} until {format_time(renew_own_node(authority, now()))}")
    listed = authority.sign_list(now())
    say(f"list {listed.seq} holds until {format_time(listed.expires)}")
    publish_list(environment, master_uri)


@click.command()
@click.argument("name")
@click.option("--reason", default="", help="why, for the record")
@options.master_uri
@passphrase.option
@pass_environment
def revoke(
    environment: Environment,
    name: str,
    reason: str,
    master_uri: str | None,
    passphrase_file: Path | None,
) -> None:
    """Revoke the identity of the node NAME, and notify the master at once.

    Its connections end and its key is never trusted again; to return it needs a new key.
    """
    home = AuthorityHome.at(environment.home)
    authority = home.unlock(passphrase.read(passphrase_file, environment.variables))
    listed, count = authority.revoke_identity(name, reason, now())
    say(f"revoked {name}, {count} key{'s' * (count != 1)} (list {listed.seq})")
    publish_list(environment, master_uri)
