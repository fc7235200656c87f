"""The live connections of one identity, and why each may go on.

A shell. A link is known to the watch before it is judged once more, and that before the first byte
of data passes: what was revoked while the two ends introduced themselves is found by one or the
other.
"""

import contextlib
import logging
from collections.abc import Iterator

from ca.certificates import Identity
from ca.errors import HintedError
from ca.revocation.state import Revocations
from grants.decision import Decision
from rossec import clock
from rossec.errors import HangUp
from rossec.net.aio import SecureStream
from rossec.participant.connections import termination_reason

_log = logging.getLogger("rossec.sidecar")


class PeerConnection:
    """A connection that `decision` admitted; the watch cuts it when that ends."""

    def __init__(self, stream: SecureStream[Identity], decision: Decision) -> None:
        self.stream = stream
        self.decision = decision
        self.ends = min(decision.expires, stream.peer.not_after)


class PeerConnections:
    """Those of one identity."""

    def __init__(self, revocations: Revocations) -> None:
        self._revocations = revocations
        self._connections: set[PeerConnection] = set()

    def __iter__(self) -> Iterator[PeerConnection]:
        return iter(tuple(self._connections))

    @contextlib.contextmanager
    def track(self, stream: SecureStream[Identity], decision: Decision) -> Iterator[None]:
        """A link while the block runs; a connection that ends meanwhile ends the block alone.

        Raises:
            HangUp: it must end before it begins.
        """
        connection = PeerConnection(stream, decision)
        self._connections.add(connection)
        try:
            reason = termination_reason(connection, self._revocations, clock.now())
            if reason is not None:
                raise HangUp(reason)
            with _log_end(stream):
                yield
        finally:
            self._connections.discard(connection)

    def abort(self, reason: str) -> None:
        """Cut them all."""
        for connection in self:
            connection.stream.abort(reason)


@contextlib.contextmanager
def _log_end(stream: SecureStream[Identity]) -> Iterator[None]:
    try:
        yield
    except* HintedError as group:  # the guard's too: a grant that expires between two messages
        _log.info("the connection with %s ended: %s", stream.peer.name, group.exceptions[0])
