"""The grants that one key has presented to the master, and the rights they give. Pure.

The caller of `put` has verified them; their number and size are bounded; the rights are evaluated
again when the second, the revocations or the grants change.
"""

import hashlib
from dataclasses import dataclass, field
from functools import partial
from typing import Final, NamedTuple

from ca.errors import HintedError
from ca.revocation.state import Revocations
from grants.decision import authorize
from grants.model import Grant
from grants.reach import Reach
from grants.validity import check_time
from rossec.master.rights.caller import Caller, Peer

MAX_HELD: Final = 64
MAX_HELD_BYTES: Final = 256 * 1024
MAX_FAILURES: Final = 256  # refused grants of one key in FAILURE_WINDOW; each costs a verification
FAILURE_WINDOW: Final = 60  # seconds
_NOTHING: Final = Reach(())


class EvaluationContext(NamedTuple):
    """The time and the revocation list for which grants are evaluated."""

    now: int
    revocations: bytes
    fresh_until: int


NOT_EVALUATED: Final = EvaluationContext(-1, b"", 0)


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
    _reach: Reach = _NOTHING
    _evaluated_for: tuple[EvaluationContext, int] | None = None
    _valid_ids: tuple[bytes, ...] = ()
    _caller: Caller | None = None

    def caller(
        self, peer: Peer, context: EvaluationContext, revocations: Revocations, *, wildcard: bool
    ) -> Caller:
        """The caller; the same object while neither the context nor a grant has changed."""
        caller = self._caller
        if self._evaluated_for != (context, self.version):
            self._evaluate(context, revocations)
            caller = None
        if caller is None or caller.name != peer.name or caller.wildcard is not wildcard:
            refusal = partial(
                authorize, self.grants.values(),
                holder=peer.thumbprint, now=context.now, check=revocations.check,
            )  # fmt: skip
            caller = Caller(peer.name, peer.thumbprint, self._reach, refusal, wildcard)
            self._caller = caller
        return caller

    def _evaluate(self, context: EvaluationContext, revocations: Revocations) -> None:
        """Compute the rights of the grants that are valid in `context`."""
        grants = self.grants.values()
        valid = [grant for grant in grants if _is_valid(grant, context.now, revocations)]
        ids = tuple(grant.id for grant in valid)
        if ids != self._valid_ids:
            self._reach = Reach.of(valid)
        self._evaluated_for, self._valid_ids = (context, self.version), ids

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
        self.version += 1

    def is_full_for(self, size: int) -> bool:
        """Whether a grant of `size` bytes would exceed a limit."""
        return len(self.grants) >= MAX_HELD or sum(self.sizes.values()) + size > MAX_HELD_BYTES


def _is_valid(grant: Grant, now: int, revocations: Revocations) -> bool:
    """Whether `grants.decision` would accept the grant now; its holder was checked before."""
    try:
        check_time(grant, now)
        for entry in grant.revocable:
            revocations.check(entry, now)
    except HintedError:
        return False
    return True
