"""The master of a command: where it is, and a connection or a node there.

All commands take the master's URI from here, from `--master` or ROS_MASTER_URI. Where it is
`discover:`, the master is found once, by what it announces (docs/howto/find-the-master.md).
"""

import asyncio
import contextlib
from collections.abc import AsyncIterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Final

from rossec.authority.master_connection import master_connection
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.suite_selection import post_quantum
from rossec.cli.shared.context import Environment
from rossec.errors import ChannelClosed, ConfigurationError, MasterNotFound
from rossec.home import NodeHome
from rossec.net.rpc.client import RpcClient
from rossec.participant.grant_renewal import MasterCall
from rossec.ros import settings
from rossec.ros.names import PRESENT_GRANTS

if TYPE_CHECKING:
    from rossec.node import Node

VARIABLE: Final = "ROS_MASTER_URI"
DISCOVER: Final = "discover:"
REVOCATIONS: Final = "rossec.revocations"
SETTLE: Final = 1.0  # seconds: two announcements; a command that ends at once measures no loss


def master_at(
    environment: Environment, node: str | NodeHome | None, master_uri: str | None = None
) -> str:
    """As `find_master`, outside of a loop."""
    uri = _given(environment, master_uri)
    if uri != DISCOVER:
        return uri
    return asyncio.run(find_master(environment, node, master_uri))


async def find_master(
    environment: Environment, node: str | NodeHome | None, master_uri: str | None = None
) -> str:
    """The master's URI: `master_uri`, or ROS_MASTER_URI, or ROS's default.

    Args:
        environment: of the command.
        node: the name or directory of who will call it, for `discover:`; None: any node of the
            home, if all of them trust the same authority.
        master_uri: the value of `--master`.

    Raises:
        ConfigurationError, MasterNotFound: no trust anchor, or no master found.
    """
    uri = _given(environment, master_uri)
    if uri != DISCOVER:
        return uri
    # Imported where it is asked for.
    from rossec.discovery.choose import discover_master, trusted  # noqa: PLC0415

    who = f"/{node.lstrip('/')}" if isinstance(node, str) else node
    key = trusted(environment.home, who)[0].thumbprint
    if key not in environment.found:
        looked = {**environment.variables, VARIABLE: DISCOVER}
        try:
            environment.found[key] = (await discover_master(looked, who, SETTLE))[VARIABLE]
        except MasterNotFound as error:
            environment.found[key] = error
    found = environment.found[key]
    if isinstance(found, MasterNotFound):
        raise found
    return found


async def with_master(environment: Environment, node: str | NodeHome | None) -> Mapping[str, str]:
    """The variables of the environment, for what reads ROS_MASTER_URI itself.

    Raises:
        ConfigurationError, MasterNotFound: as for `find_master`.
    """
    return {**environment.variables, VARIABLE: await find_master(environment, node)}


@contextlib.asynccontextmanager
async def node_as(environment: Environment, name: str) -> AsyncIterator["Node"]:
    """The running node `name`, for one command.

    Raises:
        HintedError, OSError: it has no identity, or the master is out of reach.
    """
    from rossec.node import Node  # noqa: PLC0415 - commands without a node do not need it

    async with Node(name, environ=await with_master(environment, name)) as node:
        yield node


def own_variables(environment: Environment) -> Mapping[str, str]:
    """The variables of the environment, for a master: ROS_MASTER_URI has its own port.

    `discover:` says where others find it, so that it listens at ROS's default.
    """
    if _given(environment, None) != DISCOVER:
        return environment.variables
    return {**environment.variables, VARIABLE: settings.DEFAULT_MASTER_URI}


def _given(environment: Environment, master_uri: str | None) -> str:
    return master_uri or environment.variables.get(VARIABLE, settings.DEFAULT_MASTER_URI)


@contextlib.asynccontextmanager
async def master_as(
    environment: Environment, home: NodeHome, uri: str, own: Credentials | None = None
) -> AsyncIterator[RpcClient]:
    """A connection to the master at `uri`, with the identity in `home`, or `own` instead.

    Raises:
        ConfigurationError: not a URI, or another node answers there; the identity is revoked.
        HintedError, OSError, TimeoutError: it is unreachable.
    """
    credentials = home.credentials() if own is None else own
    suites = post_quantum(environment.variables)
    connection = partial(master_connection, credentials, home.anchor(), uri, suites)
    try:
        async with connection() as client:
            yield client
    except ChannelClosed as error:  # as masters answer a revoked identity, but for one call
        async with connection() as client:
            if is_of_revoked(await client.ask(REVOCATIONS, home.name)):
                raise ConfigurationError(revoked_text(home.name), anew(home)) from error
        raise


def is_of_revoked(answer: object) -> bool:
    """Whether a master answered `REVOCATIONS` as it does a revoked identity."""
    match answer:
        case [bytes() as data, b""]:
            return bool(data)
        case _:
            return False


def revoked_text(name: str) -> str:
    """What is said then."""
    return f"the master says that this identity is revoked: {name}"


def anew(home: NodeHome) -> str:
    """What to do about it."""
    return f"move {home.path} away and enroll it anew: rossec node request {home.name}"


@contextlib.asynccontextmanager
async def calls_as(
    environment: Environment, home: NodeHome, uri: str, own: Credentials | None = None
) -> AsyncIterator[MasterCall]:
    """A connection on which the node has presented its grants; yields what calls over it.

    Raises:
        ConfigurationError: not a URI, or another node answers there.
        HintedError, OSError, TimeoutError: it is unreachable.
    """
    async with master_as(environment, home, uri, own) as client:

        async def call(method: str, *parameters: object) -> object:
            return await client.ask(method, home.name, *parameters)

        await call(PRESENT_GRANTS, home.grants())
        yield call
