"""Grants that the authority deposited at the master, for the nodes that hold their keys. Pure.

Each is verified, bounded per holder and in total, and durable before it is in the table. A node is
given those of its own key only, and verifies them itself: the master is not trusted for rights. A
grant leaves the table when it has ended, or when the list in force revokes it or its holder's key.
"""

from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from ca.certificates import TrustAnchor
from ca.errors import HintedError
from grants import document
from grants.decision import RevocationCheck
from grants.errors import GrantError, GrantExpired
from grants.model import Grant
from grants.token import unpack
from rossec.master.rights.presented_grants import MAX_HELD, MAX_HELD_BYTES
from rossec.master.state.deposit_journal import DepositChange, GrantDeposited, GrantHeld

MAX_TOTAL: Final = 64 * 1024  # grants of all nodes
MAX_TOTAL_BYTES: Final = 64 * 1024 * 1024
ANSWER_BYTES: Final = 128 * 1024  # of grants in one answer, unless one alone is larger

VerifyDeposit = Callable[[bytes, int], Grant]
"""The content of a grant that may be deposited at this time; raises a `HintedError` otherwise."""

Persist = Callable[[Sequence[DepositChange]], None]
"""Makes changes durable. Raises a `HintedError`: then they must not take effect."""


class DeliveryState(Enum):
    """How far the delivery of one grant is."""

    UNKNOWN = ""
    WAITING = "waiting"
    FETCHED = "fetched"
    HELD = "held"


@dataclass(slots=True)
class Deposit:
    """One grant in the table, as signed; it may be renewed until it `ends`."""

    data: bytes
    grant_id: bytes
    holder: bytes
    ends: int
    state: DeliveryState = DeliveryState.WAITING


class Missing(NamedTuple):
    """Grants that a node does not hold yet; `more`: not all of them."""

    grants: list[bytes]
    more: bool


def verifier(anchor: TrustAnchor, check: RevocationCheck) -> VerifyDeposit:
    """Accepts what `anchor` signed for its domain, what has not ended, and `check` lets pass."""

    def verify(data: bytes, now: int) -> Grant:
        grant = document.verify(data, anchor.public_key, domain=anchor.domain)
        if now >= grant.cap:
            raise GrantExpired(f"the grant {grant.short_id} of {grant.subject} has expired")
        for entry in (grant.id, grant.holder):
            check(entry, now)
        return grant

    return verify


def _refuse(data: bytes, now: int) -> Grant:
    raise GrantError(f"this master takes no deposits, also not of {len(data)} bytes at {now}")


def _forget(changes: Sequence[DepositChange]) -> None:
    """A master without a disk."""


class Deposits:
    """The table of deposits, by holder and by id.

    Args:
        verify: decides what may be deposited; by default nothing.
        persist: called before a deposit takes effect.

    Attributes:
        unsaved: the grants presented since this was emptied: to be recorded at leisure, as a node
            presents them again.
    """

    def __init__(self, verify: VerifyDeposit = _refuse, persist: Persist = _forget) -> None:
        self.verify = verify
        self._persist = persist
        self.unsaved: list[GrantHeld] = []
        self._by_id: dict[bytes, Deposit] = {}
        self._by_holder: dict[bytes, dict[bytes, Deposit]] = {}
        self._size = 0
        self._first_end: int | None = None

    def __len__(self) -> int:
        return len(self._by_id)

    def restore(self, changes: Iterable[DepositChange]) -> None:
        """Take what a journal of this master says; it was verified before it was written."""
        for change in changes:
            match change:
                case GrantDeposited(data):
                    with suppress(GrantError):  # written by another version of rossec
                        self._insert(_deposit(data, document.peek(data)))
                case GrantHeld(grant_id) if grant_id in self._by_id:
                    self._by_id[grant_id].state = DeliveryState.HELD
                case GrantHeld():
                    pass

    def changes(self) -> list[DepositChange]:
        """The shortest journal of this table."""
        deposits = self._by_id.values()
        held = (GrantHeld(each.grant_id) for each in deposits if each.state is DeliveryState.HELD)
        return [*(GrantDeposited(each.data) for each in deposits), *held]

    def add(self, verified: Sequence[tuple[bytes, Grant | HintedError]]) -> list[str]:
        """Add the grants that `verify` accepted; returns why each was refused, empty where not.

        Raises:
            HintedError: they cannot be made durable; none was added.
        """
        accepted: dict[bytes, Deposit] = {}
        reasons: list[str] = []
        for data, grant in verified:
            try:
                if isinstance(grant, HintedError):
                    raise grant
                self._admit(_deposit(data, grant), accepted)
            except HintedError as error:
                reasons.append(str(error))
            else:
                reasons.append("")
        if accepted:
            self._persist([GrantDeposited(each.data) for each in accepted.values()])
        for deposit in accepted.values():
            self._insert(deposit)
        return reasons

    def missing(
        self, holder: bytes, known: Collection[bytes], now: int, revoked: frozenset[bytes]
    ) -> Missing:
        """The grants of one key whose ids are not `known` to it, the earliest deposit first."""
        if holder in revoked:
            return Missing([], more=False)
        wanted = [
            each
            for grant_id, each in self._by_holder.get(holder, {}).items()
            if grant_id not in known and grant_id not in revoked and now < each.ends
        ]
        sent: list[bytes] = []
        size = 0
        for each in wanted:
            size += len(each.data)
            if sent and size > ANSWER_BYTES:
                break
            sent.append(each.data)
            if each.state is DeliveryState.WAITING:
                each.state = DeliveryState.FETCHED
        return Missing(sent, len(sent) < len(wanted))

    def presented(self, holder: bytes, tokens: Iterable[bytes]) -> None:
        """The node with the key `holder` has presented these tokens, renewed ones too."""
        own = self._by_holder.get(holder)
        if own is None:
            return
        waiting = {each.data: each for each in own.values() if each.state is not DeliveryState.HELD}
        for token in tokens if waiting else ():
            deposit = waiting.get(_signed_part(token))
            if deposit is not None:
                deposit.state = DeliveryState.HELD
                self.unsaved.append(GrantHeld(deposit.grant_id))

    def state(self, grant_id: bytes) -> DeliveryState:
        """How far the delivery of a grant is; UNKNOWN: it is not in the table (any more)."""
        deposit = self._by_id.get(grant_id)
        return DeliveryState.UNKNOWN if deposit is None else deposit.state

    def drop_ended(self, now: int, revoked: frozenset[bytes]) -> None:
        """Remove what has ended at `now` or is `revoked`, itself or with its holder's key."""
        ended = set(self._by_id.keys() & revoked)
        for holder in self._by_holder.keys() & revoked:
            ended |= self._by_holder[holder].keys()
        if self._first_end is not None and now >= self._first_end:
            ended |= {each.grant_id for each in self._by_id.values() if now >= each.ends}
        for grant_id in ended:
            self._remove(grant_id)
        if ended:
            self._first_end = min((each.ends for each in self._by_id.values()), default=None)

    def _admit(self, deposit: Deposit, accepted: dict[bytes, Deposit]) -> None:
        """Add to `accepted` unless it is in the table; raises a `GrantError` without room."""
        known = self._by_id.get(deposit.grant_id)
        if known is not None and known.data == deposit.data:
            return
        own = dict(self._by_holder.get(deposit.holder, {}))
        own |= {key: each for key, each in accepted.items() if each.holder == deposit.holder}
        own[deposit.grant_id] = deposit
        if len(own) > MAX_HELD or _size(own.values()) > MAX_HELD_BYTES:
            raise GrantError(
                f"the master takes at most {MAX_HELD} grants of one node",
                "revoke those that are not needed, or sign one grant with several rights",
            )
        total = self._size + _size(accepted.values()) + len(deposit.data)
        count = len(self._by_id) + len(accepted)
        if count >= MAX_TOTAL or total > MAX_TOTAL_BYTES:
            raise GrantError(
                f"the master holds {count} grants and takes no more",
                "hand the grant over as a file: rossec grant install FILE on the node's machine",
            )
        accepted[deposit.grant_id] = deposit

    def _insert(self, deposit: Deposit) -> None:
        known = self._by_id.get(deposit.grant_id)
        if known is not None:  # another signature of the same grant
            deposit.state = known.state
            self._remove(deposit.grant_id)
        self._by_id[deposit.grant_id] = deposit
        self._by_holder.setdefault(deposit.holder, {})[deposit.grant_id] = deposit
        self._size += len(deposit.data)
        if self._first_end is None or deposit.ends < self._first_end:
            self._first_end = deposit.ends

    def _remove(self, grant_id: bytes) -> None:
        deposit = self._by_id.pop(grant_id)
        own = self._by_holder[deposit.holder]
        del own[grant_id]
        if not own:
            del self._by_holder[deposit.holder]
        self._size -= len(deposit.data)


def _deposit(data: bytes, grant: Grant) -> Deposit:
    return Deposit(data, grant.id, grant.holder, grant.cap)


def _size(deposits: Iterable[Deposit]) -> int:
    return sum(len(each.data) for each in deposits)


def _signed_part(token: bytes) -> bytes:
    """The grant in a token, as the authority signed it; empty if it is malformed."""
    try:
        return unpack(token).grant
    except GrantError:
        return b""
