"""The calls that deliver grants: the authority deposits them, each node fetches its own. Pure.

Nothing here is trusted for rights: a node verifies what it fetches. A deposit is verified in turns,
as each costs a signature, and then takes effect in one step, after it was made durable.
"""

from collections.abc import Sequence
from typing import Final

from ca.errors import HintedError
from grants.model import Grant
from rossec.master.api import arguments as arg
from rossec.master.api.methods import (
    CallRequest,
    GrantsDeposited,
    Method,
    Methods,
    Reply,
    Steps,
)
from rossec.master.api.statement_calls import binaries, refusals_answered
from rossec.master.rights.caller import Refused
from rossec.master.rights.deposits import DeliveryState, Deposits
from rossec.master.rights.statements import TrustState
from rossec.master.state.deposit_journal import ID_SIZE

WATCH_GRANTS: Final = "rossec.watchGrants"
DEPOSIT_LIMIT: Final = 64  # grants in one call
STATES_LIMIT: Final = 256
KNOWN_LIMIT: Final = 256  # ids that a node names
_HOLDER_SIZE: Final = 32
_BATCH: Final = 8  # verifications, a millisecond, between two yields


class DepositCalls:
    """Handlers over the table of deposits; `statements` says what is revoked and presented."""

    def __init__(self, statements: TrustState, deposits: Deposits) -> None:
        self._statements = statements
        self._deposits = deposits

    def methods(self) -> Methods:
        """The entries of the method table."""
        known = arg.binary("known")
        return {
            "rossec.depositGrants": Method(
                (arg.binaries("grants", DEPOSIT_LIMIT),), [], self._deposit
            ),
            "rossec.deliveryStates": Method(
                (arg.binaries("grants", STATES_LIMIT),), [], self._states
            ),
            "rossec.fetchGrants": Method((known,), {}, self._fetch),
            WATCH_GRANTS: Method((known,), {}, self._fetch),
        }

    def _deposit(self, request: CallRequest) -> Steps:
        verified: list[tuple[bytes, Grant | HintedError]] = []
        for number, data in enumerate(binaries(request.arguments[1]), 1):
            verified.append((data, self._verified(data, request.now)))
            if not number % _BATCH:
                yield
        self._deposits.drop_ended(request.now, self._statements.revoked())
        with refusals_answered():
            reasons = self._deposits.add(verified)
        return _deposited(request, verified, reasons)

    def _verified(self, data: bytes, now: int) -> Grant | HintedError:
        try:
            return self._deposits.verify(data, now)
        except HintedError as error:
            return error

    def _fetch(self, request: CallRequest) -> Reply:
        known = frozenset(_split(request.binary(1), ID_SIZE, KNOWN_LIMIT))
        found = self._deposits.missing(
            request.caller.thumbprint, known, request.now, self._statements.revoked()
        )
        return Reply({"grants": found.grants, "more": found.more}, "grants")

    def _states(self, request: CallRequest) -> Reply:
        entries = binaries(request.arguments[1])
        if any(len(entry) != ID_SIZE + _HOLDER_SIZE for entry in entries):
            raise Refused("a grant is named by its id and the thumbprint of its holder's key")
        self._deposits.drop_ended(request.now, self._statements.revoked())
        return Reply([self._state(entry).value for entry in entries], "states")

    def _state(self, entry: bytes) -> DeliveryState:
        grant_id, holder = entry[:ID_SIZE], entry[ID_SIZE:]
        if self._statements.has_presented(holder, grant_id):
            return DeliveryState.HELD
        return self._deposits.state(grant_id)


def is_empty(answer: object) -> bool:
    """Whether an answer to a node has no grant."""
    match answer:
        case [1, _, {"grants": []}]:
            return True
        case _:
            return False


def _deposited(
    request: CallRequest,
    verified: Sequence[tuple[bytes, Grant | HintedError]],
    reasons: list[str],
) -> Reply:
    holders = [
        grant.holder
        for (_, grant), reason in zip(verified, reasons, strict=True)
        if isinstance(grant, Grant) and not reason
    ]
    event = GrantsDeposited(request.caller.identity, frozenset(holders), len(holders))
    refused = len(reasons) - len(holders)
    status = f"{len(holders)} grants deposited" + (f", {refused} refused" if refused else "")
    return Reply(reasons, status, events=(event,) if holders else ())


def _split(value: bytes, size: int, most: int) -> list[bytes]:
    """The items of `size` bytes that `value` consists of."""
    if len(value) % size or len(value) > size * most:
        raise Refused(f"expected at most {most} ids of {size} bytes, one after the other")
    return [value[at : at + size] for at in range(0, len(value), size)]
