"""Carry the newest revocation list to the master, as the authority's own node `/ca`."""

from ca.errors import HintedError
from rossec.authority import AuthorityHome
from rossec.cli.context import Environment
from rossec.errors import ConfigurationError, NotDelivered
from rossec.net.rpc import RpcClient
from rossec.net.stream import Flavour, connect
from rossec.node.slave import MASTER
from rossec.ros import settings

_HINT = "the list is signed and kept; deliver it with: rossec ca publish"


async def deliver(environment: Environment, master_uri: str | None) -> None:
    """Send the list to the master at `master_uri`, by default ROS_MASTER_URI.

    Raises:
        NotDelivered: the master is out of reach or refuses the list.
    """
    uri = master_uri or environment.variables.get("ROS_MASTER_URI", settings.DEFAULT_MASTER_URI)
    host, port = settings.parse_uri(uri, "the master's URI")
    home = AuthorityHome.at(environment.home)
    node, data = home.node(), home.revocation_list()
    try:
        stream = await connect(
            host, port, node.credentials(), node.anchor().verify, opening=Flavour.HTTP
        )
        try:
            if stream.peer.name != MASTER:
                raise ConfigurationError(f"{stream.peer.name} answers there", "see ROS_MASTER_URI")
            await RpcClient(stream).ask("rossec.updateRevocations", node.name, data)
        finally:
            await stream.close()
    except (HintedError, OSError, TimeoutError) as error:
        raise NotDelivered(f"the master at {uri} did not take the list: {error}", _HINT) from error
