"""The console's side of `rossec ca serve` put together: who may look, what it shows and does."""

import asyncio
from collections.abc import Callable, Mapping
from pathlib import Path

from ca.approvals.statement import Kind
from rossec.authority.console.access import Access
from rossec.authority.console.acts import Act
from rossec.authority.console.admission import ConsolePeers
from rossec.authority.console.approving import Approving, Of
from rossec.authority.console.console_socket import ConsolePlace, ConsoleSocket
from rossec.authority.console.grant_acts import GrantAct
from rossec.authority.console.identity_acts import EnrollAct, IntermediateAct
from rossec.authority.console.master_view import MasterView
from rossec.authority.console.policy_acts import DelegateAct, PolicyAct
from rossec.authority.console.record_acts import InvitationAct, PasskeyAct, RevokeMasterAct
from rossec.authority.console.removals import Removals
from rossec.authority.console.service import ConsoleService
from rossec.authority.keyservice.network import NetworkWork
from rossec.authority.keyservice.operations import KeyOperations
from rossec.authority.keyservice.rounds import Rounds
from rossec.authority.keyservice.work import AuthorityWork
from rossec.authority.master_call import MasterCall
from rossec.errors import ConfigurationError, NotDelivered


def _no_address() -> str:
    raise ConfigurationError(
        "this service has no join port", "start it without --no-network: rossec ca serve"
    )


class Console:
    """What the service has for the console.

    Args:
        where: the socket.
        rossec_home: ROSSEC_HOME.
        operations: of the key.
        network: None: no master is called, and no node joins.
        policy: its file; None: the usual place.
        join_address: where nodes reach the join port, `host:port`, for join codes.
    """

    def __init__(
        self,
        where: ConsolePlace,
        rossec_home: Path,
        operations: KeyOperations,
        network: NetworkWork | None,
        policy: Path | None = None,
        join_address: Callable[[], str] = _no_address,
    ) -> None:
        self.where = where
        self.peers = ConsolePeers()
        work = network.work if network else AuthorityWork(rossec_home, operations, _fail, policy)
        self.rounds = network.rounds if network else Rounds(asyncio.to_thread)
        operations.on_unlock = self.rounds.wake
        self.access = Access(work, operations.audit)
        of = Of(work, operations.audit, self.rounds.wake, self.access.counter)
        acts = acts_of(work, self.access, join_address)
        self.approving = Approving(of, acts)
        self.rounds.add(self.approving.carry_out_waiting, first=True)
        self.master = MasterView(work, network.deliver if network else _fail)
        self.service = ConsoleService(
            self.access,
            self.approving,
            self.master,
            Removals(work, self.rounds.wake),
            audit=operations.audit,
        )
        self.socket = ConsoleSocket(where, self.service, self.peers)


def acts_of(
    work: AuthorityWork, access: Access, join_address: Callable[[], str]
) -> Mapping[Kind, Act]:
    """What a phone can approve."""
    policy = work.policy_path()
    return {
        Kind.ENROLL: EnrollAct(policy),
        Kind.GRANT: GrantAct(policy),
        Kind.POLICY: PolicyAct(policy),
        Kind.DELEGATE: DelegateAct(),
        Kind.INTERMEDIATE: IntermediateAct(),
        Kind.PASSKEY: PasskeyAct(access.proposals),
        Kind.INVITATION: InvitationAct(work.home(), join_address),
        Kind.REVOKE_MASTER: RevokeMasterAct(),
    }


def _fail(call: MasterCall) -> object:
    raise NotDelivered(f"the master did not get {call.what}: this service calls none", call.hint)
