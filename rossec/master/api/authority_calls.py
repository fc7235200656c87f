"""What the authority's own node asks for a person: how far a list has come, who was denied. Pure.

Only `/ca` may call these (`rossec.master.rights.access_rules`). Times are given as seconds ago: the
clocks of two hosts may differ, and XML-RPC's integers end in 2038.
"""

from collections.abc import Callable, Iterable
from typing import Final

from ca.domains.aliases import is_alias
from rossec.master.api.methods import CallRequest, Method, Methods, Reply
from rossec.master.rights.caller import Peer
from rossec.master.rights.recent_denials import RecentDenials
from rossec.master.rights.statements import TrustState

STANDING: Final = "rossec.revocationStanding"
DENIALS: Final = "rossec.recentDenials"
MAX_LACKING: Final = 64  # names in one answer


class AuthorityCalls:
    """Handlers over what the master knows.

    Args:
        connected: the certified identities that have a connection now.
    """

    def __init__(
        self,
        statements: TrustState,
        denials: RecentDenials,
        connected: Callable[[], Iterable[Peer]],
    ) -> None:
        self._statements = statements
        self._denials = denials
        self._connected = connected

    def methods(self) -> Methods:
        """The entries of the method table."""
        return {
            STANDING: Method((), {}, self._standing),
            DENIALS: Method((), [], self._recent_denials),
        }

    def _standing(self, request: CallRequest) -> Reply:
        key = request.caller.thumbprint  # the authority has signed the list and needs none
        own = (peer for peer in self._connected() if not is_alias(peer.name))
        nodes = [peer for peer in own if peer.thumbprint != key]
        found = self._statements.standing(nodes, request.now)
        epoch, seq = self._statements.list_number
        answer = {
            "list": f"{epoch}.{seq}",
            "nodes": found.nodes,
            "holding": found.holding,
            "lacking": list(found.lacking[:MAX_LACKING]),
        }
        return Reply(answer, "standing of the revocation list")

    def _recent_denials(self, request: CallRequest) -> Reply:
        answer = [
            [max(0, request.now - denial.at), denial.node, int(denial.right), denial.name]
            for denial in self._denials.newest_first(request.now)
        ]
        return Reply(answer, "denials of the last day")
