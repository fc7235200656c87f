"""Grants at the master: those that nodes presented, and those that the authority deposited. Pure.

The caller of `PresentedGrants.put` has verified them, each with the key of its domain, and grants
of one domain give nothing on names of another; the rights are evaluated again when the second, the
revocations or the grants change. A deposit is verified, bounded per holder and in total, and durable
before it is in the table. A node is given those of its own key only, and verifies them itself: the
master is not trusted for rights. A grant leaves the table when it has ended, or when the list in
force revokes it or its holder's key.
"""

import hashlib
from collections.abc import Callable, Collection, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import Final, NamedTuple

from ca.certificates import TrustAnchor
from ca.errors import HintedError
from grants import document
from grants.decision import Decision, Reach, RevocationCheck, authorize, check_tail
from grants.errors import GrantError, GrantExpired, GrantNotHeld
from grants.model import Grant, Right, check_time
from grants.token import check_one_domain, unpack
from rossec.master.rights.caller import Caller, CertifiedPeer, DomainOf, OriginRights, no_domain
from rossec.master.state.journals import DepositChange, GrantDeposited, GrantHeld


def check_holder(caller: Caller, grant: Grant, label: str) -> None:
    # It is the caller's own: by its key, its domain and its name.
    if grant.holder != caller.thumbprint:
        raise GrantNotHeld("the grant is bound to another key", f"it was issued to {grant.subject}")
    name = caller.certified or caller.name
    check_one_domain(grant, label, name)
    check_tail(grant, name, tail=caller.has_tail)


MAX_HELD: Final = 64
MAX_HELD_BYTES: Final = 256 * 1024
MAX_FAILURES: Final = 256  # refused grants of one key in FAILURE_WINDOW; each costs a verification
FAILURE_WINDOW: Final = 60  # seconds
_NOTHING: Final = Reach(())


class EvaluationContext(NamedTuple):
    now: int
    revocations: bytes
    fresh_until: int
    elsewhere: int = 0


NOT_EVALUATED: Final = EvaluationContext(-1, b"", 0)


class Judge(NamedTuple):
    """How the grants of a peer are judged."""

    domain: str  # the own trust domain
    # called with the domain of a grant, an entry of it and the time; raises if revoked
    check: Callable[[str, bytes, int], None]
    domain_of: DomainOf = no_domain  # domain_of, exported: as of `Caller`
    exported: Reach | None = None


class VerifiedGrants(NamedTuple):
    held: int
    refused: tuple[str, ...]


class Renewed(NamedTuple):
    tokens: tuple[bytes, ...]
    refused: tuple[str, ...]


@dataclass(slots=True)
class PresentedGrants:
    """Verified grants of one key by the digest of their bytes, and their size."""

    grants: dict[bytes, Grant] = field(default_factory=dict)
    sizes: dict[bytes, int] = field(default_factory=dict)
    failures: int = 0
    failing_since: int = 0
    version: int = 0
    has_tails: bool = False
    _reach: Reach = _NOTHING
    _elsewhere: dict[str, Reach] = field(default_factory=dict)
    _evaluated_for: tuple[EvaluationContext, int] | None = None
    _valid_ids: tuple[bytes, ...] = ()
    _caller: Caller | None = None

    def caller(
        self, peer: CertifiedPeer, context: EvaluationContext, judge: Judge, *, wildcard: bool
    ) -> Caller:
        caller = self._caller
        if self._evaluated_for != (context, self.version):
            self._evaluate(context, judge)
            caller = None
        if caller is None or caller.name != peer.name or caller.wildcard is not wildcard:
            refusal = partial(self._refuse, judge, peer.thumbprint, context.now)
            caller = Caller(
                peer.name,
                peer.thumbprint,
                self._reach,
                partial(refusal, judge.domain),
                wildcard,
                elsewhere={
                    domain: OriginRights(reach, partial(refusal, domain))
                    for domain, reach in self._elsewhere.items()
                },
                domain_of=judge.domain_of,
                exported=judge.exported,
            )
            self._caller = caller
        return caller

    def _evaluate(self, context: EvaluationContext, judge: Judge) -> None:
        # As `grants.decision` would accept them now; who holds them was checked before.
        valid: list[Grant] = []
        for grant in self.grants.values():
            with suppress(HintedError):
                check_time(grant, context.now)
                for entry in grant.revocable:
                    judge.check(grant.domain, entry, context.now)
                valid.append(grant)
        ids = tuple(grant.id for grant in valid)
        if ids != self._valid_ids:
            by_domain: dict[str, list[Grant]] = {}
            for grant in valid:
                by_domain.setdefault(grant.domain, []).append(grant)
            self._reach = Reach.of(by_domain.pop(judge.domain, ()))
            self._elsewhere = {domain: Reach.of(held) for domain, held in by_domain.items()}
        self._evaluated_for, self._valid_ids = (context, self.version), ids

    def _refuse(
        self, judge: Judge, holder: bytes, now: int, domain: str, right: Right, name: str
    ) -> Decision:
        held = [grant for grant in self.grants.values() if grant.domain == domain]
        check = partial(judge.check, domain)
        return authorize(held, right, name, holder=holder, now=now, check=check)

    def drop_expired(self, now: int) -> None:
        self.drop(lambda grant: grant.expires <= now)

    def drop(self, is_dropped: Callable[[Grant], bool]) -> None:
        for key in [key for key, grant in self.grants.items() if is_dropped(grant)]:
            del self.grants[key], self.sizes[key]
            self.version += 1

    def count_failure(self, now: int) -> None:
        self.failures += 1
        if self.failures == 1:
            self.failing_since = now

    def has_failed_too_often(self, now: int) -> bool:
        if not 0 <= now - self.failing_since < FAILURE_WINDOW:
            self.failures = 0
        return self.failures >= MAX_FAILURES

    def put(self, token: bytes, grant: Grant) -> None:
        for key in [key for key, other in self.grants.items() if other.id == grant.id]:
            if self.grants[key].expires > grant.expires:
                return
            del self.grants[key], self.sizes[key]
        key = hashlib.sha256(token).digest()
        self.grants[key], self.sizes[key] = grant, len(token)
        self.has_tails = self.has_tails or grant.has_tail_patterns
        self.version += 1

    def is_full_for(self, size: int) -> bool:
        return len(self.grants) >= MAX_HELD or sum(self.sizes.values()) + size > MAX_HELD_BYTES


MAX_TOTAL: Final = 64 * 1024  # grants of all nodes
MAX_TOTAL_BYTES: Final = 64 * 1024 * 1024
ANSWER_BYTES: Final = 128 * 1024  # of grants in one answer, unless one alone is larger

# The content of a grant that may be deposited at this time; raises a `HintedError` otherwise
VerifyDeposit = Callable[[bytes, int], Grant]
# Makes changes durable. Raises a `HintedError`: then they must not take effect
Persist = Callable[[Sequence[DepositChange]], object]


class DeliveryState(Enum):
    UNKNOWN = ""
    WAITING = "waiting"
    FETCHED = "fetched"
    HELD = "held"


@dataclass(slots=True)
class Deposit:
    data: bytes
    grant_id: bytes
    holder: bytes
    ends: int
    state: DeliveryState = DeliveryState.WAITING

    @staticmethod
    def of(data: bytes, grant: Grant) -> "Deposit":
        return Deposit(data, grant.id, grant.holder, grant.cap)


class Missing(NamedTuple):
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


class Deposits:
    """The table of deposits, by holder and by id; `persist` is called before one takes effect."""

    def __init__(self, verify: VerifyDeposit = _refuse, persist: Persist = lambda _changes: None) -> None:
        self.verify = verify
        self._persist = persist
        # the grants presented since this was emptied: to be recorded at leisure, as a node presents them
        # again
        self.unsaved: list[GrantHeld] = []
        self._by_id: dict[bytes, Deposit] = {}
        self._by_holder: dict[bytes, dict[bytes, Deposit]] = {}
        self._size = 0
        self._first_end: int | None = None

    def __len__(self) -> int:
        return len(self._by_id)

    def restore(self, changes: Iterable[DepositChange]) -> None:
        # Of a journal of this master: it was verified before it was written.
        for change in changes:
            match change:
                case GrantDeposited(data):
                    with suppress(GrantError):
                        self._insert(Deposit.of(data, document.peek(data)))
                case GrantHeld(grant_id) if grant_id in self._by_id:
                    self._by_id[grant_id].state = DeliveryState.HELD
                case GrantHeld():
                    pass

    def changes(self) -> list[DepositChange]:
        # The shortest journal of this table.
        deposits = self._by_id.values()
        held = (GrantHeld(each.grant_id) for each in deposits if each.state is DeliveryState.HELD)
        return [*(GrantDeposited(each.data) for each in deposits), *held]

    def add(self, verified: Sequence[tuple[bytes, Grant | HintedError]]) -> list[str]:
        # Why each was refused, empty where not.
        accepted: dict[bytes, Deposit] = {}
        reasons: list[str] = []
        for data, grant in verified:
            reason = ""
            try:
                if isinstance(grant, HintedError):
                    raise grant
                self._admit(Deposit.of(data, grant), accepted)
            except HintedError as error:
                reason = str(error)
            reasons.append(reason)
        # Durable before it is acknowledged: the operator may switch off the authority's machine.
        if accepted:
            self._persist([GrantDeposited(each.data) for each in accepted.values()])
        for deposit in accepted.values():
            self._insert(deposit)
        return reasons

    def missing(
        self, holder: bytes, known: Collection[bytes], now: int, revoked: frozenset[bytes]
    ) -> Missing:
        # The grants of one key whose ids are not `known` to it, the earliest deposit first.
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
        # Renewed tokens too.
        own = self._by_holder.get(holder)
        if own is None:
            return
        waiting = {each.data: each for each in own.values() if each.state is not DeliveryState.HELD}
        for token in tokens if waiting else ():
            with suppress(GrantError):
                deposit = waiting.get(unpack(token).grant)
                if deposit is not None:
                    deposit.state = DeliveryState.HELD
                    self.unsaved.append(GrantHeld(deposit.grant_id))

    def state(self, grant_id: bytes) -> DeliveryState:
        """How far the delivery of a grant is; UNKNOWN: it is not in the table (any more)."""
        deposit = self._by_id.get(grant_id)
        return DeliveryState.UNKNOWN if deposit is None else deposit.state

    def drop_ended(self, now: int, revoked: frozenset[bytes]) -> None:
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
        # Add to `accepted` unless it is in the table; raises a `GrantError` without room.
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


def _size(deposits: Iterable[Deposit]) -> int:
    return sum(len(each.data) for each in deposits)
