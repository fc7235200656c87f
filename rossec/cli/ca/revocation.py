"""`rossec ca revoke | refresh | publish`: revoke identities, sign the list, deliver it."""

from pathlib import Path

import click

from ca.domains.aliases import is_alias, local_name, shown
from rossec import files
from rossec.authority import restored_lists
from rossec.authority.service import AuthorityService
from rossec.authority.signing import OWN_NODE
from rossec.cli.shared import options
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_list
from rossec.clock import format_time
from rossec.errors import ConfigurationError
from rossec.terminal import note, record, say


@click.command()
@options.master_uri
@json_result()
@pass_service
def publish(service: AuthorityService) -> None:
    """Give the newest revocation list to the master.

    The passphrase is needed only where something is revoked that is in no signed list yet.
    """
    if count := service.home.count_unlisted(now()):
        note(f"{count} revocation{'s' * (count != 1)} in no signed list yet: it is signed anew")
        service.complete_list()
    record(published=False)
    service.publish()
    record(published=True)
    say("the master has the newest list")


@click.command()
@click.option(
    "--list", "older", type=options.FILE,
    help="first revoke what this list revokes: a node's, from before a restore that lacked it",
)  # fmt: skip
@click.option(
    "--entries", type=options.FILE,
    help="of that list where it is a tree; by default revocations.entries beside it",
)  # fmt: skip
@options.master_uri
@json_result()
@pass_service
def refresh(service: AuthorityService, older: Path | None, entries: Path | None) -> None:
    """Sign the revocation list anew, before it expires, and give it to the master.

    The authority's own node is renewed as well when two thirds of its life are over.
    """
    if older is not None:
        taken = service.take_over_revocations(*restored_lists.read_files(older, entries))
        say(f"{taken} revocations were taken over from {older}")
    listed, renewed = service.refresh()
    record(list=listed.seq, expires=listed.expires, own_identity_expires=renewed)
    if renewed is not None:
        say(f"renewed {OWN_NODE} until {format_time(renewed)}")
    say(f"list {listed.seq} holds until {format_time(listed.expires)}")
    publish_list(service)


@click.command()
@click.argument("names", metavar="NAME...", nargs=-1, required=True)
@click.option("--reason", default="", help="why, for the record")
@click.option(
    "--certificate", type=options.FILE,
    help="of a node of another domain: revoke the key in this node.pem, and no other",
)  # fmt: skip
@click.option(
    "--thing", "of_thing", is_flag=True,
    help="revoke what is said of the thing NAME; the node that stands for it keeps its identity",
)  # fmt: skip
@options.master_uri
@json_result()
@pass_service
def revoke(
    service: AuthorityService,
    names: tuple[str, ...],
    reason: str,
    certificate: Path | None,
    of_thing: bool,
) -> None:
    """Revoke the identity of the node NAME, or with --thing the thing NAME, at once.

    Its connections end and its key is never trusted again; to return it needs a new key. With a
    border router its things end as well: it has the keys of their nodes.

    NAME may be one of another domain, as hospital:/rounds/robot3: every key of it that is recorded
    here (by rossec grant sign) is refused in this domain, whatever its own authority says. Where
    one of several is refused the others are revoked, and the exit code is 1.
    """
    names = unique(names)
    if certificate is not None and len(names) > 1:
        raise click.UsageError("--certificate is of one NAME")
    if len(names) > 1:
        service.unlock()  # a wrong passphrase is no fault of a name
    batch = Batch(len(names), "name")
    for name in names:
        with batch.item(name):
            say(_revoke_thing(service, name, reason) if of_thing
                else _revoke_node(service, name, reason, certificate))  # fmt: skip
    if batch.done:
        publish_list(service)
    batch.finish()


def _revoke_thing(service: AuthorityService, name: str, reason: str) -> str:
    listed, count = service.revoke_thing(name, reason)
    record(statements=count, list=listed.seq)
    return f"revoked the thing {name}, {count} statement{'s' * (count != 1)} (list {listed.seq})"


def _revoke_node(
    service: AuthorityService, name: str, reason: str, certificate: Path | None
) -> str:
    local = local_name(name)
    if is_alias(local):
        pem = b"" if certificate is None else files.read(certificate, options.MAX_PEM)
        listed, count = service.revoke_foreigner(local, reason, pem)
    elif certificate is not None:
        raise ConfigurationError(
            f"{name} is a node of this domain, whose keys are in the record",
            "--certificate is for nodes of other domains: LABEL:/NAME",
        )
    else:
        listed, count = service.revoke_identity(name, reason)
        for intermediate in service.intermediates():
            note(
                f"{intermediate} may have certified other keys for {shown(local)}, which are not"
                " in this record: rossec ca import NODE.pem and revoke again, or revoke"
                f" {intermediate}"
            )
    record(keys=count, list=listed.seq)
    return f"revoked {shown(local)}, {count} key{'s' * (count != 1)} (list {listed.seq})"
