"""The console's side of `rossec ca serve` put together: who may look, what it shows and does."""

from rossec.authority.console.access import Access
from rossec.authority.console.admission import ConsolePeers
from rossec.authority.console.console_socket import ConsolePlace, ConsoleSocket
from rossec.authority.console.removals import Removals
from rossec.authority.console.service import ConsoleService
from rossec.authority.keyservice.network import NetworkWork
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.work import AuthorityWork


class Console:
    """What the service has for the console.

    Args:
        where: the socket.
        work: of the authority.
        operations: of its key.
        network: None: no master is called, and no node joins.
    """

    def __init__(
        self,
        where: ConsolePlace,
        work: AuthorityWork,
        operations: KeyOperations,
        network: NetworkWork | None,
    ) -> None:
        self.where = where
        self.peers = ConsolePeers()
        self.access = Access(work, operations.audit)
        wake = _nothing if network is None else network.rounds.wake
        self.service = ConsoleService(self.access, Removals(work, wake))
        self.socket = ConsoleSocket(where, self.service, self.peers)


def _nothing() -> None:
    """Nobody waits for a round."""
