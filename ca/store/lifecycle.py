"""The life of a request for an identity: pending, then approved or denied, then issued.

The states of Kubernetes' certificate signing requests: to approve is a person's word, to issue is
the authority's act, and both are recorded apart. The table is the whole truth; the record enforces
it a second time, by triggers made from it. Everything ends: a request has a date after which it
can no longer be used and is collected. What was issued stays in the record for good, so that one
request never gets two certificates.
"""

from enum import StrEnum
from typing import Final, NamedTuple, NoReturn

from ca.errors import RequestClosed, StoreError

HOUR: Final = 3600
DAY: Final = 24 * HOUR
MAX_OPEN: Final = 256  # strangers can ask: what they leave here is bounded


class RequestState(StrEnum):
    """Where a request stands."""

    PENDING = "pending"
    APPROVED = "approved"
    DENIED = "denied"
    ISSUED = "issued"

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise StoreError(
            f"the record has a request in a state that is none: {str(value)[:40]!a}",
            "restore it from a backup, and find out who changed it",
        )


TRANSITIONS: Final[dict[RequestState, frozenset[RequestState]]] = {
    RequestState.PENDING: frozenset({RequestState.APPROVED, RequestState.DENIED}),
    RequestState.APPROVED: frozenset({RequestState.ISSUED, RequestState.DENIED}),
    RequestState.DENIED: frozenset(),
    RequestState.ISSUED: frozenset(),
}
OPEN: Final = frozenset(state for state, following in TRANSITIONS.items() if following)
# Seconds after its last change. A day is a person's evening and morning; an answer is kept for a
# week, so that who asked can still be told.
RETENTION: Final[dict[RequestState, int]] = {
    RequestState.PENDING: DAY,
    RequestState.APPROVED: DAY,
    RequestState.DENIED: 7 * DAY,
    RequestState.ISSUED: 7 * DAY,
}
_HINTS: Final = {
    RequestState.PENDING: "first approve it: rossec ca approve",
    RequestState.APPROVED: "",
    RequestState.DENIED: "if that was a mistake, have the node make a new request",
    RequestState.ISSUED: "one request gets one certificate; to have another: rossec ca renew NAME",
}


class RequestRow(NamedTuple):
    """One request, as recorded; `digest` is the SHA-256 of `der`, `source` is where it came from.

    `changed` is when it came into its `state`, `reason` what was said then; `replaces`: approved in
    words although the name lives with another key; `wildcard`: for anonymous nodes too.
    """

    digest: bytes
    name: str
    thumbprint: bytes
    der: bytes
    source: str
    arrived: int
    state: RequestState
    reason: str
    changed: int
    replaces: bool = False
    wildcard: bool = False

    @property
    def expires(self) -> int:
        """The last second at which it may be used; after it, it is collected."""
        return self.changed + RETENTION[self.state]


def advance(row: RequestRow, state: RequestState, now: int, reason: str = "") -> RequestRow:
    """Return the request in its next state.

    Raises:
        RequestClosed: the table does not lead there, or the request's time is over.
    """
    if state not in TRANSITIONS[row.state]:
        raise RequestClosed(
            f"the request of {row.name} is {row.state} and cannot be {state}", _HINTS[row.state]
        )
    if now > row.expires:
        raise RequestClosed(
            f"the request of {row.name} was {row.state} for too long and is void",
            "have the node make a new request",
        )
    return row._replace(state=state, reason=reason, changed=now)
