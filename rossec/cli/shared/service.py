"""The authority of a command: its passphrase and its master are those of the options."""

import asyncio
import functools
from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, Final

from ca.errors import HintedError
from grants import document
from rossec import files
from rossec.authority.service import AuthorityService, MasterCall
from rossec.cli.shared import passphrase
from rossec.cli.shared.context import Environment, now, pass_environment
from rossec.cli.shared.master import master_as, master_at
from rossec.errors import NotDelivered
from rossec.home import NodeHome
from rossec.ros import settings
from rossec.terminal import note, say

_SIGNED_ANEW: Final = (
    "the revocation list was due and is signed anew; deliver it with: rossec ca publish"
)


def service_of(
    environment: Environment, passphrase_file: Path | None = None, master_uri: str | None = None
) -> AuthorityService:
    """The authority in ROSSEC_HOME."""
    return AuthorityService(
        environment.home,
        partial(passphrase.read, passphrase_file, environment.variables),
        partial(call_master, environment, master_uri),
        now,
    )


def pass_service(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add `--passphrase-file` to a command, and pass it the authority instead of that option.

    The value of `--master` (`options.master_uri`) is taken for the authority as well.
    """

    @pass_environment
    @functools.wraps(command)
    def run(environment: Environment, /, *, passphrase_file: Path | None, **values: Any) -> None:
        master_uri = values.pop("master_uri", None)
        with closing(service_of(environment, passphrase_file, master_uri)) as service:
            command(service, **values)

    return passphrase.option(run)


def call_master(environment: Environment, master_uri: str | None, call: MasterCall) -> None:
    """Call the master at `master_uri`, by default ROS_MASTER_URI, as the authority's own node.

    Raises:
        NotDelivered: the master is unreachable or refuses the statement.
    """
    if call.note:
        note(call.note)
    uri = master_at(environment, master_uri)
    settings.parse_uri(uri, "the master's URI")

    async def ask() -> None:
        async with master_as(environment, call.node, uri) as client:
            await client.ask(call.method, call.node.name, *call.statement)

    try:
        asyncio.run(ask())
    except (HintedError, OSError, TimeoutError) as error:
        what = f"the master at {uri} did not take {call.what}: {error}"
        raise NotDelivered(what, call.hint) from error


def publish_list(service: AuthorityService) -> None:
    """Deliver the list that was signed just now, and say so."""
    service.publish()
    say("the master has the new list")


def publish_if_revoked(service: AuthorityService) -> None:
    """Deliver the list if a replaced key was revoked; else print a note if it was signed anew."""
    if service.has_revoked:
        say("the replaced key is revoked")
        publish_list(service)
        return
    remind_to_publish(service)


def remind_to_publish(service: AuthorityService) -> None:
    """Print a note if the list was signed anew."""
    if service.has_signed_list:
        note(_SIGNED_ANEW)


def deliver_grant(service: AuthorityService, node: str, data: bytes, out: Path | None) -> None:
    """Store a grant in its node's directory if that is on this host, and in the file `out`."""
    if out is not None:
        files.create(out, data, 0o644)
        say(f"written to {out}")
    home = NodeHome.of(service.rossec_home, node)
    if home.path.is_dir():
        home.add_grant(document.grant_id(data), data)
        say(f"given to {node} in {home.path}")
    elif out is None:
        note(
            f"{node} is on another host:"
            " sign with --out FILE, then `rossec grant install FILE` there"
        )
