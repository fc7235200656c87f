"""The addresses a node registered as its own: only a connection to one of them may reach itself.

An address that a peer sends is not enough: the answer to `requestTopic` could send a node back to
itself. A redirect from another node to this one is therefore refused (`check_redirect`).
"""

from rossec.errors import ConnectionHeaderRefused

Address = tuple[str, int]


class OwnAddresses:
    """The addresses of one node.

    Attributes:
        host: the host name it registers; empty while it does not listen.
    """

    def __init__(self) -> None:
        self.host = ""
        self._ports: set[int] = set()

    def add_ports(self, host: str, *ports: int) -> None:
        """Add ports this node listens on."""
        self.host = host
        self._ports.update(ports)

    def is_own(self, address: Address) -> bool:
        """Whether this node listens at this host and port."""
        host, port = address
        return self.host != "" and _plain(host) == _plain(self.host) and port in self._ports

    def check_redirect(self, first: Address, then: Address) -> None:
        """Refuse a redirect from another node back to this one.

        Raises:
            ConnectionHeaderRefused: `first` is not this node and sent `then`, which is.
        """
        if self.is_own(then) and not self.is_own(first):
            host, port = first
            raise ConnectionHeaderRefused(
                f"the node at {host} port {port} sends this node to itself"
            )


def _plain(host: str) -> str:
    return host.lower().removeprefix("[").removesuffix("]")
