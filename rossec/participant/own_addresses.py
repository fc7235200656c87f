"""Where this node listens, as it registered that: only a dial to such a place may reach itself.

An address that a peer names is not enough: a publisher that is asked where a topic is could send a
node back to itself. So whoever was met first at another place leads nowhere here (`check_step`).
"""

from rossec.channel.edhoc.own_dials import OwnDials
from rossec.errors import ConnectionHeaderRefused

Address = tuple[str, int]


class OwnAddresses:
    """The places of one node.

    Attributes:
        host: what it tells others to come to; empty while it listens nowhere.
        dials: those that are meant for itself.
    """

    def __init__(self) -> None:
        self.host = ""
        self.dials = OwnDials()
        self._ports: set[int] = set()

    def listens(self, host: str, *ports: int) -> None:
        """It listens there."""
        self.host = host
        self._ports.update(ports)

    def is_own(self, place: Address) -> bool:
        """Whether this node listens at this host and port."""
        host, port = place
        return self.host != "" and _plain(host) == _plain(self.host) and port in self._ports

    def dials_for(self, place: Address) -> OwnDials | None:
        """What a dial to `place` is noted in; None: it is meant for another node."""
        return self.dials if self.is_own(place) else None

    def check_step(self, first: Address, then: Address) -> None:
        """Refuse to be led from another node back to this one.

        Raises:
            ConnectionHeaderRefused: `first`, which named `then`, is not this node, and `then` is.
        """
        if self.is_own(then) and not self.is_own(first):
            host, port = first
            raise ConnectionHeaderRefused(
                f"the node at {host} port {port} sends this node to itself"
            )


def _plain(host: str) -> str:
    return host.lower().removeprefix("[").removesuffix("]")
