"""The open connections of one identity, each with its authorization.

A shell. A connection is known to the watchdog before it is checked once more, and checked before
the first byte of data passes: one of the two finds what was revoked during the handshake.
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
    """A connection that `decision` admitted; the watchdog closes it when that ends."""

    def __init__(self, stream: SecureStream[Identity], decision: Decision) -> None:
        self.stream = stream
        self.decision = decision
        self.ends = min(decision.expires, stream.peer.not_after)


class PeerConnections:
    """The connections of one identity."""

    def __init__(self, revocations: Revocations) -> None:
        self._revocations = revocations
        self._connections: set[PeerConnection] = set()

    def __iter__(self) -> Iterator[PeerConnection]:
        return iter(tuple(self._connections))

    @contextlib.contextmanager
    def track(self, stream: SecureStream[Identity], decision: Decision) -> Iterator[None]:
        """Register a connection while the block runs; if the connection ends, only the block ends.

        Raises:
            HangUp: the connection is not allowed any more.
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
        """Close all connections."""
        for connection in self:
            connection.stream.abort(reason)


@contextlib.contextmanager
def _log_end(stream: SecureStream[Identity]) -> Iterator[None]:
    try:
        yield
    except* HintedError as group:  # also the guard's: a grant that expires between two messages
        _log.info("the connection with %s ended: %s", stream.peer.name, group.exceptions[0])
