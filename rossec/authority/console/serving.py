"""The console's side of `rossec ca serve` put together: who may look, what it shows and does."""

import asyncio
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from ca.approvals.statement import Kind
from ca.errors import HintedError
from rossec import clock
from rossec.authority.console.access import Access
from rossec.authority.console.acts import Act
from rossec.authority.console.admission import ConsolePeers
from rossec.authority.console.approving import Approving, Of
from rossec.authority.console.console_socket import ConsolePlace, ConsoleSocket
from rossec.authority.console.grant_acts import GrantAct
from rossec.authority.console.identity_acts import EnrollAct, IntermediateAct
from rossec.authority.console.master_view import MasterView
from rossec.authority.console.policy_acts import DelegateAct, PolicyAct
from rossec.authority.console.policy_names import PolicyNames
from rossec.authority.console.policy_view import PolicyLook
from rossec.authority.console.questions import Questions
from rossec.authority.console.reading import Reading
from rossec.authority.console.record_acts import InvitationAct, PasskeyAct, RevokeMasterAct
from rossec.authority.console.removals import Removals
from rossec.authority.console.service import ConsoleService
from rossec.authority.console.status import StatusLook
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


DELIVERIES_KEPT: Final = 10.0  # seconds
PURPOSE: Final = "a look at the console"


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
        self._network = network
        of = Of(work, operations.audit, self.rounds.wake, self.access.counter)
        self.approving = Approving(of, acts_of(work, self.access, join_address))
        self.rounds.add(self.approving.carry_out_waiting, first=True)
        self.master = MasterView(
            work, network.deliver if network else _fail, came_back=self.rounds.wake
        )
        self.service = ConsoleService(
            self.access,
            StatusLook(work, operations.held, self._has_master, self._seen),
            Reading(work, self.access.last_used, Deliveries(work, self._has_master).states),
            Questions(work),
            PolicyLook(work),
            PolicyNames(work),
            self.approving,
            self.master,
            Removals(work, self.rounds.wake),
            audit=operations.audit,
        )
        self.socket = ConsoleSocket(where, self.service, self.peers)

    def _has_master(self) -> bool:
        return self._network is not None and self._network.has_master

    def _seen(self) -> tuple[object, ...]:
        """What the console shows and the record does not say."""
        return self.master.look(), *(each.id for each in self.access.proposals.all())


class Deliveries:
    """What the master says of each grant in force; asked while it answers, and not every time."""

    def __init__(self, work: AuthorityWork, has_master: Callable[[], bool]) -> None:
        self._work = work
        self._has_master = has_master
        self._states: dict[bytes, str] = {}
        self._asked = float("-inf")

    def states(self) -> dict[bytes, str]:
        """By the id of the grant; empty while there is no master."""
        now = time.monotonic()
        if not self._has_master():
            return {}
        if now - self._asked > DELIVERIES_KEPT:
            self._asked = now
            try:
                with self._work.service(PURPOSE) as service:
                    self._states = service.delivery_states()
            except HintedError:
                self._states = {}
        return self._states


def acts_of(
    work: AuthorityWork,
    access: Access,
    join_address: Callable[[], str],
    elapsed: clock.Seconds | None = None,
) -> Mapping[Kind, Act]:
    """What a phone can approve; `elapsed` counts seconds and cannot be set."""
    policy = work.policy_path()
    return {
        Kind.ENROLL: EnrollAct(policy),
        Kind.GRANT: GrantAct(policy),
        Kind.POLICY: PolicyAct(policy),
        Kind.DELEGATE: DelegateAct(),
        Kind.INTERMEDIATE: IntermediateAct(),
        Kind.PASSKEY: PasskeyAct(access.proposals),
        Kind.INVITATION: InvitationAct(work.home(), join_address, elapsed),
        Kind.REVOKE_MASTER: RevokeMasterAct(),
    }


def _fail(call: MasterCall) -> object:
    raise NotDelivered(f"the master did not get {call.what}: this service calls none", call.hint)
