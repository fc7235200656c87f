"""A connection to the master for one command, as a node."""

import contextlib
from collections.abc import AsyncIterator

from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.records import ChannelLimits
from rossec.channel.suite_selection import post_quantum
from rossec.cli.shared.context import Environment
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.ros import settings
from rossec.ros.names import MASTER


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
    host, port = settings.parse_uri(uri, "the master's URI")
    context = SecureContext(
        home.credentials() if own is None else own,
        home.anchor().verify,
        suites=post_quantum(environment.variables),
        dial_limits={WireProtocol.HTTP: ChannelLimits()},  # `limits: body` is the master's to set
    )
    stream = await connect(host, port, context, WireProtocol.HTTP)
    try:
        if stream.peer.name != MASTER:
            raise ConfigurationError(f"{stream.peer.name} answers there", "see ROS_MASTER_URI")
        yield RpcClient(stream)
    finally:
        await stream.close()
