"""The grants that one key has presented to the master, and the rights they give. Pure.

The caller of `put` has verified them, each with the key of its domain, and grants of one domain
give nothing on names of another. Their number and size are bounded, for all domains together; the
rights are evaluated again when the second, the revocations or the grants change.
"""

import hashlib
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

from ca.errors import HintedError
from grants.decision import Decision, authorize
from grants.model import Grant, Right
from grants.reach import Reach
from grants.validity import check_time
from rossec.master.rights.caller import Caller, DomainOf, OriginRights, Peer, no_domain

MAX_HELD: Final = 64
MAX_HELD_BYTES: Final = 256 * 1024
MAX_FAILURES: Final = 256  # refused grants of one key in FAILURE_WINDOW; each costs a verification
FAILURE_WINDOW: Final = 60  # seconds
_NOTHING: Final = Reach(())


class EvaluationContext(NamedTuple):
    """The time, the revocation list and the state of other domains grants are evaluated for."""

    now: int
    revocations: bytes
    fresh_until: int
    elsewhere: int = 0


NOT_EVALUATED: Final = EvaluationContext(-1, b"", 0)


class Judge(NamedTuple):
    """How the grants of a peer are judged.

    Attributes:
        domain: the own trust domain.
        check: called with the domain of a grant, an entry of it and the time; raises if revoked.
        domain_of, exported: as of `Caller`.
    """

    domain: str
    check: Callable[[str, bytes, int], None]
    domain_of: DomainOf = no_domain
    exported: Reach | None = None


class Presented(NamedTuple):
    """How many grants of the caller are held now, and why the others were refused."""

    held: int
    refused: tuple[str, ...]


class Renewed(NamedTuple):
    """Renewed tokens, empty where one was refused, and the reasons."""

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
        self, peer: Peer, context: EvaluationContext, judge: Judge, *, wildcard: bool
    ) -> Caller:
        """The caller; the same object while neither the context nor a grant has changed."""
        caller = self._caller
        if self._evaluated_for != (context, self.version):
            self._evaluate(context, judge)
            caller = None
        if caller is None or caller.name != peer.name or caller.wildcard is not wildcard:
            refusal = partial(self._refuse, judge, peer.thumbprint, context.now)
            caller = Caller(
                peer.name, peer.thumbprint, self._reach, partial(refusal, judge.domain), wildcard,
                elsewhere={
                    domain: OriginRights(reach, partial(refusal, domain))
                    for domain, reach in self._elsewhere.items()
                },
                domain_of=judge.domain_of, exported=judge.exported,
            )  # fmt: skip
            self._caller = caller
        return caller

    def _evaluate(self, context: EvaluationContext, judge: Judge) -> None:
        """Compute the rights of the grants that are valid in `context`."""
        grants = self.grants.values()
        valid = [grant for grant in grants if _is_valid(grant, context.now, judge)]
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
        """Decide by the grants of one domain; raises as `grants.decision.authorize`."""
        held = [grant for grant in self.grants.values() if grant.domain == domain]
        check = partial(judge.check, domain)
        return authorize(held, right, name, holder=holder, now=now, check=check)

    def drop_domains(self, domains: Collection[str]) -> None:
        """Remove the grants of these domains: their keys may be others now."""
        for key in [key for key, grant in self.grants.items() if grant.domain in domains]:
            del self.grants[key], self.sizes[key]
            self.version += 1

    def drop_tails(self) -> None:
        """Remove the grants on names of anonymous nodes: the key speaks without their tail."""
        for key in [key for key, grant in self.grants.items() if grant.has_tail_patterns]:
            del self.grants[key], self.sizes[key]
            self.version += 1
        self.has_tails = False

    def drop_expired(self, now: int) -> None:
        """Remove expired grants."""
        for key in [key for key, grant in self.grants.items() if grant.expires <= now]:
            del self.grants[key], self.sizes[key]
            self.version += 1

    def count_failure(self, now: int) -> None:
        """Count a refused grant of this key."""
        self.failures += 1
        if self.failures == 1:
            self.failing_since = now

    def has_failed_too_often(self, now: int) -> bool:
        """Whether the grants of this key are not verified for now."""
        if not 0 <= now - self.failing_since < FAILURE_WINDOW:
            self.failures = 0
        return self.failures >= MAX_FAILURES

    def put(self, token: bytes, grant: Grant) -> None:
        """Add a grant, in place of an older version of it: it may have been renewed."""
        for key in [key for key, other in self.grants.items() if other.id == grant.id]:
            if self.grants[key].expires > grant.expires:
                return
            del self.grants[key], self.sizes[key]
        key = hashlib.sha256(token).digest()
        self.grants[key], self.sizes[key] = grant, len(token)
        self.has_tails = self.has_tails or grant.has_tail_patterns
        self.version += 1

    def is_full_for(self, size: int) -> bool:
        """Whether a grant of `size` bytes would exceed a limit."""
        return len(self.grants) >= MAX_HELD or sum(self.sizes.values()) + size > MAX_HELD_BYTES


def _is_valid(grant: Grant, now: int, judge: Judge) -> bool:
    """Whether `grants.decision` would accept the grant now; its holder was checked before."""
    try:
        check_time(grant, now)
        for entry in grant.revocable:
            judge.check(grant.domain, entry, now)
    except HintedError:
        return False
    return True
