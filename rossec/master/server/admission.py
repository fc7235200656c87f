"""What a peer may use of the master before a grant gives it any right here. A shell.

A certificate costs a foreign authority nothing, and a node without grants has few calls to make:
its bodies are small, and so is the number of its connections, of a foreign domain for all nodes
without a right together. A grant is shown when one that the key has presented is valid now.
"""

from collections.abc import Awaitable
from typing import cast

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.master.operation.limits import MasterLimits
from rossec.master.server.effects import MasterState
from rossec.net.aio import SecureStream
from rossec.net.rpc.server import Dispatch
from rossec.net.rpc.turns import source_of
from rossec.ros.names import PRESENT_GRANTS


class Admission:
    """Decides by the rights that `state` knows now, within `limits`."""

    def __init__(self, state: MasterState, limits: MasterLimits) -> None:
        self._state = state
        self._limits = limits

    def has_rights(self, peer: Identity) -> bool:
        """Whether any grant of `peer` is valid now, or it is the authority or a listed master."""
        try:
            return self._state.trust.caller(peer, self._state.now()).has_rights
        except HintedError:
            return False

    def body_bound(self, peer: Identity) -> int:
        """How many bytes a call of `peer` may have now."""
        if self.has_rights(peer):
            return self._limits.body
        return min(self._limits.body, self._limits.body_without_right)

    def has_room_for(self, peer: Identity) -> bool:
        """Whether one more connection is within the limits; a foreign authority has any key."""
        source = source_of(peer)
        peers = [stream.peer for stream in self._state.streams]
        of_group = [other for other in peers if source_of(other).group == source.group]
        if peer.is_foreign and len(of_group) >= self._limits.connections_per_domain:
            return False
        if not self._has_room_without_right(peer, of_group):
            return False
        of_key = sum(other.thumbprint == peer.thumbprint for other in of_group)
        return of_key < self._limits.connections_per_identity

    def _has_room_without_right(self, peer: Identity, of_group: list[Identity]) -> bool:
        most = self._limits.connections_without_right
        if len(of_group) < most or self.has_rights(peer):
            return True
        shown = {each.thumbprint: each for each in of_group}
        shown = {key: each for key, each in shown.items() if self.has_rights(each)}
        return sum(each.thumbprint not in shown for each in of_group) < most

    def dispatch_unshown(
        self,
        stream: SecureStream[Identity],
        dispatch: Dispatch[Identity],
        method: str,
        params: tuple[object, ...],
        peer: Identity,
    ) -> object:
        """Answer a call of a peer without rights, which may present grants by it."""
        value = dispatch(method, params, peer)
        return self._presented(stream, value) if method == PRESENT_GRANTS else value

    async def _presented(self, stream: SecureStream[Identity], value: object) -> object:
        """From now on longer calls arrive, if a grant was shown."""
        answer = await cast("Awaitable[object]", value) if isinstance(value, Awaitable) else value
        if self.has_rights(stream.peer):
            stream.raise_unit_limit()
        return answer
