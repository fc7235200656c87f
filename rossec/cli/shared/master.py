"""A connection to the master for one command, as a node."""

import contextlib
from collections.abc import AsyncIterator

from rossec.authority.master_connection import master_connection
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.suite_selection import post_quantum
from rossec.cli.shared.context import Environment
from rossec.home import NodeHome
from rossec.net.rpc.client import RpcClient
from rossec.ros import settings


def master_at(environment: Environment, master_uri: str | None = None) -> str:
    """The master's URI: `master_uri`, or ROS_MASTER_URI, or ROS's default."""
    default = environment.variables.get("ROS_MASTER_URI", settings.DEFAULT_MASTER_URI)
    return master_uri or default


@contextlib.asynccontextmanager
async def master_as(
    environment: Environment, home: NodeHome, uri: str, own: Credentials | None = None
) -> AsyncIterator[RpcClient]:
    """A connection to the master at `uri`, with the identity in `home`, or `own` instead.

    Raises:
        ConfigurationError: not a URI, or another node answers there.
        HintedError, OSError, TimeoutError: it is unreachable.
    """
    credentials = home.credentials() if own is None else own
    suites = post_quantum(environment.variables)
    async with master_connection(credentials, home.anchor(), uri, suites) as client:
        yield client
