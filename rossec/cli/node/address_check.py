"""What `rossec doctor` says of addresses: that of this host, and those of nodes it may reach.

The commonest fault of a ROS network: a name that only one host knows, or the address of yesterday.
Whoever gives it away notices nothing; whoever is given it finds nobody there.
"""

import asyncio
from collections.abc import AsyncIterator, Iterator, Mapping
from contextlib import suppress
from itertools import islice
from typing import Final

from ca.domains.aliases import shown
from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.home import NodeHome
from rossec.net.host import own_address
from rossec.participant.grant_renewal import MasterCall
from rossec.ros import settings
from rossec.ros.names import PRESENT_GRANTS
from rossec.ros.text import printable

Outcome = str | HintedError
"""A line that is ok, or a fault that does not end the check."""

LIMIT: Final = 64  # nodes whose address is looked up
_ENTER: Final = "enter the name in /etc/hosts here, or set ROS_IP on its host and start it again"


def check_own_address(variables: Mapping[str, str]) -> Iterator[Outcome]:
    """Whether ROS_HOSTNAME or ROS_IP leads to this host.

    Raises:
        ConfigurationError: it does not.
    """
    address = settings.own_address(variables)
    if address is None:
        return
    yield own_address.check_own_address(address, own_address.variable_of(variables))


async def check_node_addresses(home: NodeHome, call: MasterCall) -> AsyncIterator[Outcome]:
    """Whether the host names of the nodes that the master shows to this one are known here."""
    await call(PRESENT_GRANTS, home.grants())
    for name in islice(_nodes(await call("getSystemState")), LIMIT):
        with suppress(ConfigurationError):  # a service without a slave API
            host, _ = settings.parse_uri(str(await call("lookupNode", name)))
            if not await asyncio.to_thread(own_address.resolved, host):
                yield ConfigurationError(
                    f"{shown(name)} is at {printable(host)}, a name that this host does not know",
                    _ENTER,
                )


def _nodes(state: object) -> list[str]:
    """Who publishes or provides what this node may see, each once."""
    match state:
        case [list() as publishers, _, list() as services]:
            entries = [*publishers, *services]
            nodes = [node for entry in entries for node in (entry[1] if len(entry) == 2 else ())]
            return list(dict.fromkeys(map(str, nodes)))
        case _:
            return []
