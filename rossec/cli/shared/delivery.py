"""Deliver the newest revocation list to the master, as the authority's own node `/ca`."""

import asyncio
from typing import Final

from ca.errors import CertificateExpired, HintedError
from ca.revocation.state import open_statement
from ca.revocation.tree import is_tree
from ca.store.record import Store
from rossec.authority.home import AuthorityHome
from rossec.cli.shared.context import Environment, format_time, now
from rossec.cli.shared.master import master_as, master_at
from rossec.errors import ConfigurationError, NotDelivered
from rossec.ros import settings
from rossec.terminal import note, say

_HINT = (
    "the list is signed and stored, but takes effect only when the master has it;"
    " deliver it with: rossec ca publish"
)
_EXPIRES_SOON: Final = 7 * 86400


def remind_to_publish(store: Store, number: tuple[int, int]) -> None:
    """Print a note if signing made a new list: `number` was the next list's number before."""
    if store.next_number() != number:
        note("the revocation list was due and is signed anew; deliver it with: rossec ca publish")


async def deliver(environment: Environment, master_uri: str | None) -> None:
    """Send the list to the master at `master_uri`, by default ROS_MASTER_URI.

    Raises:
        ConfigurationError: the list has expired.
        NotDelivered: the master is unreachable or refuses the list.
    """
    home = AuthorityHome.at(environment.home)
    data = _unexpired_list(home)
    method = "rossec.updateRevocationTree" if is_tree(data) else "rossec.updateRevocations"
    statement = (data, home.tree_entries()) if is_tree(data) else (data,)
    await deliver_statement(environment, master_uri, method, statement, "the list", _HINT)


def publish_list(environment: Environment, master_uri: str | None) -> None:
    """Deliver the list that was signed just now, and say so; see `deliver`."""
    asyncio.run(deliver(environment, master_uri))
    say("the master has the new list")


async def deliver_statement(
    environment: Environment,
    master_uri: str | None,
    method: str,
    statement: tuple[bytes, ...],
    what: str,
    hint: str,
) -> None:
    """Send a signed statement to the master by `method`, as the authority's own node.

    Raises:
        NotDelivered: the master is unreachable or refuses `what`; `hint` is passed on.
    """
    uri = master_at(environment, master_uri)
    settings.parse_uri(uri, "the master's URI")
    node = AuthorityHome.at(environment.home).node()
    try:
        node.identity(now())
    except CertificateExpired as error:
        raise ConfigurationError(
            f"the identity of {node.name} has expired, no master accepts it",
            f"renew it: rossec ca renew {node.name}",
        ) from error
    try:
        async with master_as(environment, node, uri) as client:
            await client.ask(method, node.name, *statement)
    except (HintedError, OSError, TimeoutError) as error:
        raise NotDelivered(f"the master at {uri} did not take {what}: {error}", hint) from error


def _unexpired_list(home: AuthorityHome) -> bytes:
    """The newest list; under an expired one no grant is valid."""
    data = home.revocation_list()
    expires = open_statement(data, home.anchor().public_key).expires
    if now() >= expires:
        raise ConfigurationError(
            f"the revocation list expired {format_time(expires)}",
            "sign it anew with: rossec ca refresh",
        )
    if now() >= expires - _EXPIRES_SOON:
        note(
            f"the revocation list expires {format_time(expires)}; renew it with: rossec ca refresh"
        )
    return data
