"""A connection to the master for a few calls, as a node whose directory is on this host."""

from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from ca.certificates import TrustAnchor
from ca.names import is_master_name
from rossec.channel.edhoc.credentials import Credentials
from rossec.channel.records import ChannelLimits
from rossec.errors import ChannelError, ConfigurationError
from rossec.net.aio import SecureContext, WireProtocol, as_master, connect
from rossec.net.rpc import CALL_DEADLINE, RpcClient
from rossec.ros import names


@asynccontextmanager
async def master_connection(
    own: Credentials, anchor: TrustAnchor, uri: str, suites: tuple[int, ...], deadline: float = CALL_DEADLINE
) -> AsyncIterator[RpcClient]:
    """A connection to the master at `uri`, with the identity `own`, under the root `anchor`."""
    # Any master of the own domain will do: what is delivered is signed, and who calls names a URI. Those of
    # other domains are not, so that the list of them is not needed here. `deadline`: seconds for a call,
    # some of which wait.
    host, port = names.parse_uri(uri, "the master's URI")
    context = SecureContext(
        own,
        anchor.verify,
        suites=suites,
        dial_limits={WireProtocol.HTTP: ChannelLimits()},  # `limits: body` is the master's to set
    )
    try:
        stream = await connect(host, port, context, WireProtocol.HTTP)
    except ChannelError as error:
        raise as_master(error) from error
    try:
        if not is_master_name(stream.peer.name):
            raise ConfigurationError(f"{stream.peer.name} answers there", "see ROS_MASTER_URI")
        yield RpcClient(stream, deadline=deadline)
    finally:
        await stream.close()
