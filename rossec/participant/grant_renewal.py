"""When a node has its grants renewed, and what it does with the answer.

Call `renew` every few seconds, and before registering on a new connection: a node that was off for
long holds grants that have expired but may still be renewed.
"""

import logging
from collections.abc import Awaitable
from typing import Final, Protocol

from grants.errors import GrantError
from rossec.errors import AnswerMalformed
from rossec.participant.access import HeldGrant
from rossec.participant.access_interfaces import HeldGrants
from rossec.ros.text import printable

METHOD: Final = "rossec.renewGrants"
MAX_PER_CALL: Final = 16  # grants in one call: the limit of the master
RETRY: Final = 60  # seconds at most until a grant that was not renewed is requested again
_TRIES: Final = 4  # requests at least in the rest of its lifetime

_log = logging.getLogger("rossec.node")


class Renewals:
    """Selects the grants of one node that are due, and takes the renewed ones."""

    def __init__(self, access: HeldGrants) -> None:
        self._access = access
        self._retry_at: dict[bytes, int] = {}
        self._epoch = access.epoch
        self._outdated: set[bytes] = set()

    def due(self, now: int) -> list[HeldGrant]:
        """Grants to be renewed now, the first to expire first; a refused one is due later.

        In a new epoch of the revocation list sequence numbers restart: earlier tickets are invalid.
        """
        began = self._access.epoch > self._epoch
        self._epoch = self._access.epoch
        if began:
            self._retry_at.clear()
            self._outdated = {held.token for held in self._access.held_grants() if held.grant.via}
        due = [
            held
            for held in self._access.held_grants()
            if (due_at(held) <= now or held.token in self._outdated)
            and now < held.grant.cap
            and held.grant.expires < held.grant.cap
            and self._retry_at.get(held.grant.id, 0) <= now
        ]
        chosen = sorted(due, key=lambda held: held.grant.expires)[:MAX_PER_CALL]
        self._retry_at.update({held.grant.id: now + _pause(held, now) for held in chosen})
        return chosen

    def take(self, requested: list[HeldGrant], answer: object, now: int) -> int:
        """Hold the renewed grants; returns how many of `requested` were renewed.

        Raises:
            AnswerMalformed: not one token, or an empty one, for each of `requested`.
        """
        if not isinstance(answer, list) or len(answer) != len(requested):
            raise AnswerMalformed(
                "the master's answer has a different number of grants than requested"
            )
        return sum(
            self._hold(held, token, now) for held, token in zip(requested, answer, strict=True)
        )

    def _hold(self, held: HeldGrant, token: object, now: int) -> bool:
        if not isinstance(token, bytes) or not token:
            return False
        try:
            self._access.hold_renewed(token, now)
        except GrantError as error:
            _log.warning("a grant renewed by the master is invalid: %s", printable(error))
            return False
        self._retry_at.pop(held.grant.id, None)  # only a refused grant has to wait
        return True


class MasterCall(Protocol):
    """Calls a method of the master."""

    def __call__(self, method: str, *params: object) -> Awaitable[object]:
        """The value of its answer."""


async def renew(call: MasterCall, renewals: Renewals, now: int) -> int:
    """Renew the grants that are due; returns how many were renewed.

    Raises:
        RossecError: the master refuses, sends a malformed answer, or is out of reach.
    """
    due = renewals.due(now)
    if not due:
        return 0
    return renewals.take(due, await call(METHOD, [held.original for held in due]), now)


def _pause(held: HeldGrant, now: int) -> int:
    """Seconds until it is requested again: less than the rest of its lifetime, if any."""
    left = held.grant.expires - now
    return min(RETRY, max(1, left // _TRIES)) if left > 0 else RETRY


def due_at(held: HeldGrant) -> int:
    """At about two thirds of its lifetime, spread so that nodes do not all renew at once.

    The spread comes from the grant's id, which is random enough.
    """
    lifetime = held.grant.expires - held.since
    return held.since + lifetime * (560 + held.grant.id[0] * 200 // 255) // 1000
