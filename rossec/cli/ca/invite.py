"""`rossec ca invite`: print the code by which nodes join, and say what it gives away."""

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import click

from ca.enrollment import invitation, qr
from ca.names import check_pattern
from grants.policy.model import Policy
from grants.policy.wanted import projected_for_names
from rossec import clock, files
from rossec.authority.home import AuthorityHome
from rossec.authority.invitations import MAX_USES, invite
from rossec.authority.keyservice.client import KeyServiceClient
from rossec.authority.policyfile import PolicyFile, place
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import own_address
from rossec.cli.shared.options import NEW_FILE, duration, flag, json_result, option
from rossec.errors import ConfigurationError
from rossec.host import addresses
from rossec.terminal import note, note_picture, printable, record, say_secret


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
    path: Path, projected: Callable[[Policy], Sequence[str]], whom: str, names: str
) -> list[str]:
    """What the policy gives to whoever is about to get a name, for the person who decides."""
    if not path.exists():
        return [f"there is no policy: {'it is' if whom == 'it' else 'they are'} granted nothing"]
    policy = PolicyFile.read(path, own=True).policy
    lines = projected(policy)
    if not lines:
        return [f"the policy has no rule for {whom}: {policy.defaults.decision}"]
    return [f"the policy for {names}:", *(f"  {line}" for line in lines)]
