"""`rossec ca invitations`: which there are, who joined by them, and how they end."""

import contextlib

import click

from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import (
    InvitationStatus,
    end,
    find,
    invitations,
    revoke_nodes,
)
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.batch import Batch, unique
from rossec.cli.shared.context import Environment, now
from rossec.cli.shared.results import json_result
from rossec.cli.shared.service import pass_service, publish_list, remind_to_publish
from rossec.clock import format_time
from rossec.terminal import note, printable, record, say, say_json

_REASON = "the invitation was revoked"


def show(environment: Environment, *, everything: bool, in_json: bool) -> None:
    """Show the invitations that can be used, or all of them."""
    at = now()
    with contextlib.closing(AuthorityHome.at(environment.home).store()) as store:
        found = [each for each in invitations(store) if everything or each.state(at) == "open"]
    if in_json:
        say_json([_summary(each, at) for each in found])
        return
    for each in found:
        for line in _lines(each, at):
            say(line)
    if not found:
        say("no invitations" if everything else "no open invitations")


@click.command()
@click.argument("invitation_ids", metavar="INVITATION_ID...", nargs=-1, required=True)
@click.option("--and-nodes", is_flag=True, help="also revoke every node that joined by it")
@click.option("--reason", default=_REASON, help="why, for the record")
@options.master_uri
@json_result()
@pass_service
def revoke(
    service: AuthorityService, invitation_ids: tuple[str, ...], and_nodes: bool, reason: str
) -> None:
    """End the invitation INVITATION_ID (or its beginning); who joined by it stays enrolled.

    Requests that wait for a person because of it are denied. With --and-nodes every key of the
    names that joined by it is revoked, and the master is notified at once. The first needs no key,
    so it is done also where the second cannot be.
    """
    ids, ended = unique(invitation_ids), list[InvitationStatus]()
    batch = Batch(len(ids), "id")
    for invitation_id in ids:
        with batch.item(invitation_id):
            ended.append(_end(service, invitation_id, reason))
            if not and_nodes and (uses := ended[-1].uses):
                note(f"{len(uses)} joined by it and stay enrolled; to revoke them: --and-nodes")
    if and_nodes and ended:
        _revoke_nodes(service, ended, reason)
    batch.finish()


def _end(service: AuthorityService, invitation_id: str, reason: str) -> InvitationStatus:
    with contextlib.closing(service.home.store()) as store:
        found = find(store, invitation_id)
        denied = end(store, found, reason, now())
    record(invitation=found.row.id.hex(), denied=denied)
    say(f"invitation {found.short_id} is ended")
    if denied:
        say(f"denied {denied} request{'s' * (denied != 1)} that waited")
    return found


def _revoke_nodes(service: AuthorityService, ended: list[InvitationStatus], reason: str) -> None:
    revoked, lists = list[str](), list[object]()
    for found in ended:
        listed, names = revoke_nodes(service.unlock(), found, reason, now())
        revoked += names
        lists += [listed] * (listed is not None)
    record(revoked_nodes=revoked)
    for name in revoked:
        say(f"revoked {name}")
    if lists:
        publish_list(service)
    else:
        say("no node that joined by it is left to revoke")
        remind_to_publish(service)


def _lines(each: InvitationStatus, at: int) -> list[str]:
    row = each.row
    anonymous = "  for anonymous nodes too" if row.wildcard else ""
    joined = f"{len(each.uses)} of {row.uses} joined"
    until = f"until {format_time(row.expires)}{anonymous}"
    return [
        "  ".join((each.short_id, printable(each.state(at)), row.pattern, joined, until)),
        *(f"  {use.name}  {format_time(use.at)}" for use in each.uses),
    ]


def _summary(each: InvitationStatus, at: int) -> dict[str, object]:
    row = each.row
    return {
        "id": row.id.hex(),
        "state": each.state(at).partition(":")[0],
        "reason": each.ended or "",
        "pattern": row.pattern,
        "uses": row.uses,
        "anonymous": row.wildcard,
        "made": row.at,
        "until": row.expires,
        "joined": [
            {"name": use.name, "key": use.thumbprint.hex(), "at": use.at} for use in each.uses
        ],
    }
