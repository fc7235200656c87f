"""`rossec ca invite | invitations`: codes by which nodes join, what each gives away, and who used it."""

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ca.enrollment import invitation, qr
from ca.names import check_pattern
from rossec import clock, files
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import (
    MAX_USES,
    InvitationStatus,
    end,
    find,
    invitations,
    invite,
    revoke_nodes,
)
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.service import AuthorityService
from rossec.cli.shared import options
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import own_address
from rossec.cli.shared.options import NEW_FILE, Batch, duration, flag, json_result, option, say_result
from rossec.cli.shared.service import pass_service, publish_list, remind_to_publish
from rossec.errors import ConfigurationError
from rossec.host import addresses
from rossec.terminal import note, note_picture, printable, record, say, say_secret

if TYPE_CHECKING:
    from grants.policy.model import Policy


@click.command("invite")
@click.argument("pattern")
@option(
    "--uses",
    "so many nodes may join, each with a new name",
    type=click.IntRange(1, MAX_USES),
    default=1,
    show_default=True,
)
@duration("--for lasts", "how long it can be used", days=30, default="1h")
@flag("--anonymous", "for anonymous nodes too: NAME and NAME_*")
@flag("--qr picture", "also show it as a picture, on stderr")
@option("--ndef tag", "also write it to this new file, for an NFC tag (NDEF)", type=NEW_FILE)
@option("--address given", "where nodes reach `rossec ca serve`, instead of the address found")
@json_result(pass_environment, secret=True)
def command(
    environment: Environment,
    pattern: str,
    uses: int,
    lasts: int,
    anonymous: bool,
    picture: bool,
    tag: Path | None,
    given: str | None,
) -> None:
    """Let nodes whose names PATTERN covers join by a code, without a person for each of them.

    Prints one line, the code, to be given to `rossec node join` on the robot: whoever has it can
    join, so show it to nobody else. Shows what the policy gives the names first, on stderr. A node
    whose name is known with another key waits for a person: rossec ca requests.
    """
    from grants.policy.wanted import projected_for_names  # noqa: PLC0415 - to list them needs no policy
    from rossec.authority.policyfile import place  # noqa: PLC0415 - likewise

    home, at = AuthorityHome.at(environment.home), now()
    # `host:port` of the join port; where only a host is given, the service knows its port.
    port: object = None
    if (client := KeyServiceClient.find(home.path)) is not None:
        with closing(client):
            port = client.status().get("join_port")
    port = port if isinstance(port, int) and port else addresses.JOIN_PORT
    where = addresses.join(*addresses.split(given or own_address(environment), port))
    if tag is not None and tag.exists():
        raise ConfigurationError(f"{tag} exists and is not overwritten", "name a new file")
    names = check_pattern(pattern)
    path = place(environment.home, None)
    # What the names would get is said before the code exists: after that only its end is left.
    policy = policy_lines(path, lambda policy: projected_for_names(policy, names), "them", "these names")
    code = invite(home, pattern, uses, at + lasts, where, at, wildcard=anonymous)
    _describe(code, uses, policy)
    if home.is_intermediate:
        note("  each waits for a person: this record does not know the root's names: ca requests")
    if tag is not None:
        files.create(tag, invitation.write(code))
        note(f"written for an NFC tag: {tag}")
    if picture:
        note_picture(qr.terminal(code.text()))
    record(id=code.id.hex(), pattern=code.pattern, address=code.address, until=code.expires, code=code.text())
    # Whoever has it can join: it is the last line, and with --json in the document alone.
    say_secret(code.text())


def _describe(code: invitation.InvitationCode, uses: int, policy: list[str]) -> None:
    nodes = f"{uses} nodes" if uses > 1 else "one node"
    anonymous = ", for anonymous nodes too" if code.wildcard else ""
    until = clock.format_time(code.expires)
    note(f"invitation {code.id.hex()[:8]}: {nodes} named {code.pattern}{anonymous}, until {until}")
    for line in policy:
        note(f"  {printable(line)}")
    note(f"nodes join at {code.address}: rossec node join, and paste the line there")


def policy_lines(
    path: Path, projected: Callable[["Policy"], Sequence[str]], whom: str, names: str
) -> list[str]:
    """What the policy gives to whoever is about to get a name, for the person who decides."""
    from rossec.authority.policyfile import PolicyFile  # noqa: PLC0415 - see above

    if not path.exists():
        return [f"there is no policy: {'it is' if whom == 'it' else 'they are'} granted nothing"]
    policy = PolicyFile.read(path, own=True).policy
    lines = projected(policy)
    if not lines:
        return [f"the policy has no rule for {whom}: {policy.defaults.decision}"]
    return [f"the policy for {names}:", *(f"  {line}" for line in lines)]


@click.command()
@click.argument("invitation_ids", metavar="INVITATION_ID...", nargs=-1, required=True)
@flag("--and-nodes", "also revoke every node that joined by it")
@option("--reason", "why, for the record", default="the invitation was revoked")
@options.master_uri
@json_result(pass_service)
def revoke(service: AuthorityService, invitation_ids: tuple[str, ...], and_nodes: bool, reason: str) -> None:
    """End the invitation INVITATION_ID (or its beginning); who joined by it stays enrolled.

    Requests that wait for a person because of it are denied. With --and-nodes every key of the
    names that joined by it is revoked, and the master is notified at once. The first needs no key,
    so it is done also where the second cannot be.
    """
    ids, ended = options.unique(invitation_ids), list[InvitationStatus]()
    batch = Batch(len(ids), "id")
    for invitation_id in ids:
        with batch.item(invitation_id):
            with closing(service.home.store()) as store:
                found = find(store, invitation_id)
                denied = end(store, found, reason, now())
            say(f"invitation {found.short_id} is ended", invitation=found.row.id.hex(), denied=denied)
            if denied:
                say(f"denied {denied} request{'s' * (denied != 1)} that waited")
            ended.append(found)
            if not and_nodes and (uses := ended[-1].uses):
                note(f"{len(uses)} joined by it and stay enrolled; to revoke them: --and-nodes")
    if and_nodes and ended:
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
    batch.finish()


def show(environment: Environment, *, everything: bool, in_json: bool) -> None:
    at = now()
    with closing(AuthorityHome.at(environment.home).store()) as store:
        found = [each for each in invitations(store) if everything or each.state(at) == "open"]
    none = "no invitations" if everything else "no open invitations"
    lines = (line for each in found for line in _lines(each, at)) if found else [none]
    say_result(in_json, [_summary(each, at) for each in found], lines)


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
        "joined": [{"name": use.name, "key": use.thumbprint.hex(), "at": use.at} for use in each.uses],
    }


def _lines(each: InvitationStatus, at: int) -> list[str]:
    row = each.row
    anonymous = "  for anonymous nodes too" if row.wildcard else ""
    joined = f"{len(each.uses)} of {row.uses} joined"
    until = f"until {clock.format_time(row.expires)}{anonymous}"
    return [
        "  ".join((each.short_id, printable(each.state(at)), row.pattern, joined, until)),
        *(f"  {use.name}  {clock.format_time(use.at)}" for use in each.uses),
    ]
