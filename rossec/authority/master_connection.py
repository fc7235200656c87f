"""A connection to the master for a few calls, as a node whose directory is on this host."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from ca.certificates import TrustAnchor
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.records import ChannelLimits
from rossec.errors import ConfigurationError
from rossec.net.aio import SecureContext, WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.ros import settings
from rossec.ros.names import MASTER


@asynccontextmanager
async def master_connection(
    own: Credentials, anchor: TrustAnchor, uri: str, suites: tuple[int, ...]
) -> AsyncIterator[RpcClient]:
    """A connection to the master at `uri`, with the identity `own`, under the root `anchor`.

    Raises:
        ConfigurationError: not a URI, or another node answers there.
        HintedError, OSError, TimeoutError: it is unreachable.
    """
    host, port = settings.parse_uri(uri, "the master's URI")
    context = SecureContext(
        own,
        anchor.verify,
        suites=suites,
        dial_limits={WireProtocol.HTTP: ChannelLimits()},  # `limits: body` is the master's to set
    )
    stream = await connect(host, port, context, WireProtocol.HTTP)
    try:
        if stream.peer.name != MASTER:
            raise ConfigurationError(f"{stream.peer.name} answers there", "see ROS_MASTER_URI")
        yield RpcClient(stream)
    finally:
        await stream.close()
