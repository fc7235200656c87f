"""The grants that one key has shown to the master, and what they reach. Pure.

Verified once by whoever puts them here; bounded in number and size; what they reach is worked out
anew when the second, the revocations or the grants change.
"""

import hashlib
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from ca.errors import HintedError
from ca.revocation.state import Revocations
from grants.decision import RevocationCheck, authorize
from grants.model import Grant, Right
from grants.reach import Reach
from grants.validity import check_time
from rossec.master.rights.access_rules import Caller, Peer

MAX_HELD: Final = 64
MAX_HELD_BYTES: Final = 256 * 1024
MAX_FAILURES: Final = 256  # refused grants of one key in FAILURES_WITHIN; each costs a verification
FAILURES_WITHIN: Final = 60  # seconds
NOTHING: Final = Reach(())


class Moment(NamedTuple):
    """A second, and the list in force: in one moment the same grants hold."""

    now: int
    revocations: bytes
    fresh_until: int


NEVER: Final = Moment(-1, b"", 0)


@dataclass(frozen=True)
class GrantAccess:
    """What one key may do at one moment: `reach` is of those `grants` that hold at `now`."""

    grants: Collection[Grant]
    reach: Reach
    holder: bytes
    now: int
    check: RevocationCheck

    def covers(self, right: Right, name: str) -> bool:
        """Whether a grant that holds covers `right` on `name`."""
        return self.reach.covers(right, name)

    def covers_any(self, rights: Right, name: str) -> bool:
        """Whether a grant that holds covers one of `rights` on `name`."""
        return self.reach.covers_any(rights, name)

    def covers_below(self, right: Right, space: str) -> bool:
        """Whether grants that hold cover `right` on every parameter below `space`."""
        return self.reach.covers_below(right, space)

    def touches(self, right: Right, space: str) -> bool:
        """Whether a grant that holds covers `right` on any parameter at or below `space`."""
        return self.reach.touches(right, space)

    def patterns(self, right: Right) -> int:
        """As of `Reach`."""
        return self.reach.patterns(right)

    def require(self, right: Right, name: str) -> None:
        """Raise the `GrantError` that says what is missing."""
        if not self.reach.covers(right, name):
            authorize(self.grants, right, name, holder=self.holder, now=self.now, check=self.check)


@dataclass(slots=True)
class PresentedGrants:
    """Verified grants of one key by the digest of their bytes, and their size."""

    grants: dict[bytes, Grant] = field(default_factory=dict)
    sizes: dict[bytes, int] = field(default_factory=dict)
    failures: int = 0
    failing_since: int = 0
    version: int = 0
    _reach: Reach = NOTHING
    _worked_out: tuple[Moment, int] | None = None
    _holding: tuple[bytes, ...] = ()
    _caller: Caller | None = None

    def caller(
        self, peer: Peer, moment: Moment, revocations: Revocations, *, wildcard: bool
    ) -> Caller:
        """Who calls; the very same as before while neither the moment nor a grant has changed."""
        caller = self._caller
        if self._worked_out != (moment, self.version):
            self._work_out(moment, revocations)
            caller = None
        if caller is None or caller.name != peer.name or caller.wildcard is not wildcard:
            access = GrantAccess(
                self.grants.values(), self._reach, peer.thumbprint, moment.now, revocations.check
            )
            caller = self._caller = Caller(peer.name, peer.thumbprint, access, wildcard)
        return caller

    def _work_out(self, moment: Moment, revocations: Revocations) -> None:
        """What the grants that hold now reach."""
        grants = self.grants.values()
        held = [grant for grant in grants if _holds(grant, moment.now, revocations)]
        holding = tuple(grant.id for grant in held)
        if holding != self._holding:
            self._reach = Reach(permission for grant in held for permission in grant.permissions)
        self._worked_out, self._holding = (moment, self.version), holding

    def drop_expired(self, now: int) -> None:
        """Forget what has ended."""
        for key in [key for key, grant in self.grants.items() if grant.expires <= now]:
            del self.grants[key], self.sizes[key]
            self.version += 1

    def count_failure(self, now: int) -> None:
        """A grant of this key was refused."""
        self.failures += 1
        if self.failures == 1:
            self.failing_since = now

    def has_failed_too_often(self, now: int) -> bool:
        """Whether no more of its grants are looked at for now."""
        if not 0 <= now - self.failing_since < FAILURES_WITHIN:
            self.failures = 0
        return self.failures >= MAX_FAILURES

    def put(self, token: bytes, grant: Grant) -> None:
        """Keep a grant, in place of what was known of it: it may have been renewed."""
        for key in [key for key, other in self.grants.items() if other.id == grant.id]:
            if self.grants[key].expires > grant.expires:
                return
            del self.grants[key], self.sizes[key]
        key = hashlib.sha256(token).digest()
        self.grants[key], self.sizes[key] = grant, len(token)
        self.version += 1

    def is_full_for(self, size: int) -> bool:
        """Whether a grant of `size` bytes finds no room."""
        return len(self.grants) >= MAX_HELD or sum(self.sizes.values()) + size > MAX_HELD_BYTES


def _holds(grant: Grant, now: int, revocations: Revocations) -> bool:
    """Whether `grants.decision` would take the grant now; it is bound to its holder already."""
    try:
        check_time(grant, now)
        for entry in (grant.id, *grant.via):
            revocations.check(entry, now)
    except HintedError:
        return False
    return True
