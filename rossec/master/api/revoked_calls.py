"""The calls that a revoked identity may still make: it receives the revocations only. Pure.

Both ends of a connection may be revoked at once, as below a revoked intermediate; then no peer but
these two can close it, and only the master can inform them. It sends the list without a timestamp:
without that confirmation a node closes all its connections, even if it cannot find itself in a tree
(`ca.revocation.tree`).
"""

from collections import Counter
from collections.abc import Callable
from typing import Final

from rossec.errors import HangUp
from rossec.master.api.statement_calls import PROOF_LIMIT
from rossec.master.rights.statements import TrustState

CONNECTION_SECONDS: Final = 5.0  # seconds that a connection of a revoked identity may last
MAX_CONNECTIONS: Final = 4  # such connections of one identity
MAX_BELOW_INTERMEDIATE: Final = 32  # of all identities below one intermediate
MAX_CALLS: Final = 16  # on one connection; a node makes two or three
_LIST_METHODS: Final = frozenset({"rossec.revocations", "rossec.revocationsSince"})
_UNCONFIRMED: Final = b""


class RevokedConnections:
    """Counts the connections of each revoked key."""

    def __init__(self) -> None:
        self._counts: Counter[bytes] = Counter()

    def admit(self, keys: tuple[bytes, ...]) -> bool:
        """Count one more of the identity with these keys, its own first; False: too many."""
        own, *issuers = keys
        full = self._counts[own] >= MAX_CONNECTIONS or any(
            self._counts[key] >= MAX_BELOW_INTERMEDIATE for key in issuers
        )
        if not full:
            self._counts.update(keys)
        return not full

    def release(self, keys: tuple[bytes, ...]) -> None:
        """An admitted connection has ended."""
        self._counts -= Counter(keys)  # drops zeros


class RevokedCalls:
    """Answers few calls of a revoked identity on one connection: an answer may be a whole list.

    Args:
        now: seconds since the epoch.
    """

    def __init__(self, statements: TrustState, now: Callable[[], int]) -> None:
        self._statements = statements
        self._now = now
        self._calls_left = MAX_CALLS

    def answer(self, method: str, params: tuple[object, ...], _: object) -> list[object]:
        """As `answer_revoked`, for `MAX_CALLS` calls."""
        self._calls_left -= 1
        if self._calls_left < 0:
            raise HangUp("the identity is revoked, and has been sent the list")
        return answer_revoked(self._statements, self._now(), method, params)


def answer_revoked(
    statements: TrustState, now: int, method: str, params: tuple[object, ...]
) -> list[object]:
    """Answer a call of a revoked identity.

    Raises:
        HangUp: any call but those by which a node learns that it is revoked.
    """
    match params:
        case (str(), *_) if method in _LIST_METHODS:
            # Always whole: an empty list would mean that there is none.
            return [1, "revocations", [statements.current(now)[0], _UNCONFIRMED]]
        case (str(), list() as entries) if method == "rossec.revocationProofs":
            known = [entry for entry in entries[:PROOF_LIMIT] if isinstance(entry, bytes)]
            return [1, "proofs", statements.proofs(known)]
        case _:
            raise HangUp("the identity is revoked")
