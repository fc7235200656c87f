"""The life of a request for an identity: pending, then approved or denied, then issued.

The states are those of Kubernetes' certificate signing requests: a person approves, the authority
issues, and both are recorded separately. `TRANSITIONS` is complete; triggers made from it enforce
it in the database too. Every request expires, and is collected long after. What was issued stays in
the record, so that one request never gets two certificates.
"""

from enum import StrEnum
from typing import Final, NamedTuple, NoReturn

from ca.errors import RequestClosed, StoreError

HOUR: Final = 3600
DAY: Final = 24 * HOUR
MAX_OPEN: Final = 256  # unauthenticated peers can send requests
JOINING: Final = "invitation "  # begins the source of a request that came by an invitation
MAX_JOINING: Final = 192  # open ones of those: the rest is for who enrolls nodes by hand
COLLECTED_AFTER: Final = 30 * DAY  # seconds since it expired
KEPT_EXPIRED: Final = 1024  # expired requests that stay, whatever the clock says


class RequestState(StrEnum):
    """The state of a request."""

    PENDING = "pending"
    APPROVED = "approved"
    DENIED = "denied"
    ISSUED = "issued"

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        raise StoreError(
            f"the record has a request in an unknown state: {str(value)[:40]!a}",
            "restore it from a backup, and find out who changed it",
        )


TRANSITIONS: Final[dict[RequestState, frozenset[RequestState]]] = {
    RequestState.PENDING: frozenset({RequestState.APPROVED, RequestState.DENIED}),
    RequestState.APPROVED: frozenset({RequestState.ISSUED, RequestState.DENIED}),
    RequestState.DENIED: frozenset(),
    RequestState.ISSUED: frozenset(),
}
OPEN: Final = frozenset(state for state, following in TRANSITIONS.items() if following)
# Seconds after the last change. A day gives the operator time to answer; an answer is kept for a
# week, so that the node can still fetch it.
RETENTION: Final[dict[RequestState, int]] = {
    RequestState.PENDING: DAY,
    RequestState.APPROVED: DAY,
    RequestState.DENIED: 7 * DAY,
    RequestState.ISSUED: 7 * DAY,
}
_HINTS: Final = {
    RequestState.PENDING: "first approve it: rossec ca approve REQUEST_ID",
    RequestState.APPROVED: "",
    RequestState.DENIED: "if that was a mistake, make a new request on the node",
    RequestState.ISSUED: "one request gets one certificate; to have another: rossec ca renew NAME,"
    " or where it is over rossec ca renew --expired NAME",
}


class RequestRow(NamedTuple):
    """One request, as recorded; `digest` is the SHA-256 of `der`, `source` is where it came from.

    `changed` is the time of the last change of `state`, `reason` its reason; `replaces`: approved
    although the name has another key; `wildcard`: for anonymous nodes too.
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
        """The last second at which it may be used; afterwards it counts nowhere."""
        return self.changed + RETENTION[self.state]


def advance(row: RequestRow, state: RequestState, now: int, reason: str = "") -> RequestRow:
    """Return the request in its next state.

    Raises:
        RequestClosed: no such transition, or the request has expired.
    """
    if state not in TRANSITIONS[row.state]:
        raise RequestClosed(
            f"the request of {row.name} is {row.state} and cannot be {state}", _HINTS[row.state]
        )
    if now > row.expires:
        raise RequestClosed(
            f"the request of {row.name} was {row.state} for too long and has expired",
            "make a new request on the node",
        )
    return row._replace(state=state, reason=reason, changed=now)
