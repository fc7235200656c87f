"""The console's side of `rossec ca serve` put together: who may look, what it shows and does."""

from pathlib import Path

from rossec.authority.console.access import Access
from rossec.authority.console.admission import ConsolePeers
from rossec.authority.console.console_socket import ConsolePlace, ConsoleSocket
from rossec.authority.console.service import ConsoleService
from rossec.authority.keyservice.network import NetworkWork
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.master_call import MasterCall
from rossec.errors import NotDelivered


class Console:
    """What the service has for the console.

    Args:
        where: the socket.
        rossec_home: ROSSEC_HOME.
        operations: of the key.
        network: None: no master is called, and no node joins.
        policy: its file; None: the usual place.
    """

    def __init__(
        self,
        where: ConsolePlace,
        rossec_home: Path,
        operations: KeyOperations,
        network: NetworkWork | None,
        policy: Path | None = None,
    ) -> None:
        self.where = where
        self.peers = ConsolePeers()
        work = network.work if network else AuthorityWork(rossec_home, operations, _fail, policy)
        self.access = Access(work, operations.audit)
        self.service = ConsoleService(self.access)
        self.socket = ConsoleSocket(where, self.service, self.peers)


def _fail(call: MasterCall) -> object:
    raise NotDelivered(f"the master did not get {call.what}: this service calls none", call.hint)
