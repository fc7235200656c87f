"""Authorization: may the holder of a key use a right on a name now, and under which restrictions?

Every grant the peer presented is evaluated. All restrictions of all usable permissions that cover
the request apply together (conditions AND, all filters): if the first, the last or the widest won
instead, the answer would depend on the order, or adding a grant would silently widen a right that
was narrowed on purpose. The limit of this: a peer presents only the grants it chooses, so to narrow
a right for good the wider grant must be revoked. Of a chain (`grants.narrowing`) every link must
authorize alone, and the restrictions of a narrowing see only what those before it let through: who
signs one is restricted itself, and must learn nothing by a condition of its own.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Final

from ca.errors import HintedError
from ca.names import check_name
from grants.errors import (
    GrantError,
    GrantExpired,
    GrantMissing,
    GrantNotHeld,
    GrantNotYetValid,
    GrantRevoked,
    RestrictionMismatch,
)
from grants.model import Grant, Restriction, Right, merge
from grants.validity import check_time, format_time

RevocationCheck = Callable[[bytes, int], None]

MAX_NEAR_MISSES: Final = 5

# Of several unusable grants the one that passed most checks explains the refusal.
_BY_PROGRESS: Final = (GrantNotHeld, GrantNotYetValid, GrantExpired, GrantRevoked)


@dataclass(frozen=True)
class Decision:
    """Authorized until `expires`, under `restrictions`.

    Args:
        grants: the usable grants that cover the request, ordered by id.
        expires: the earliest end of these grants, seconds since the epoch.
        restrictions: all that must be applied, by a `Guard`.
        keep_when_stale: whether every one of the permissions says so.
    """

    right: Right
    name: str
    grants: tuple[Grant, ...]
    expires: int
    restrictions: tuple[Restriction, ...]
    keep_when_stale: bool = False

    @property
    def grant_ids(self) -> tuple[bytes, ...]:
        """Ids and keys that end it: if one of them is revoked, authorize again."""
        more = (entry for grant in self.grants for entry in grant.revocable[1:])
        return (*(grant.id for grant in self.grants), *dict.fromkeys(more))

    @property
    def pad(self) -> int:
        """What is sent is padded to a multiple of so many bytes; 0: it is not."""
        return max((each.pad or 0 for each in self.restrictions), default=0)

    def require_unrestricted(self) -> None:
        """Return if there are no restrictions: for callers that have no message to apply them to.

        Raises:
            RestrictionMismatch: there are restrictions.
        """
        if self.restrictions:
            raise RestrictionMismatch(
                f"{self.right.label} on {self.name} is granted with restrictions"
                " that cannot be applied here",
                "ask for a grant without conditions and filters",
            )

    def explain(self) -> list[str]:
        """The decision as text, line by line."""
        lines = [f"{self.right.label} {self.name} until {format_time(self.expires)}"]
        lines += [f"grant {grant.short_id} to {grant.subject}" for grant in self.grants]
        lines += [line for restriction in self.restrictions for line in restriction.lines()]
        return lines if self.restrictions else [*lines, "no restrictions"]


def authorize(
    grants: Iterable[Grant],
    right: Right,
    name: str,
    *,
    holder: bytes,
    now: int,
    check: RevocationCheck,
) -> Decision:
    """Decide whether the key `holder` may use `right` on `name`.

    Args:
        grants: verified grants, as presented by the peer.
        right: exactly one right.
        name: an absolute name.
        holder: thumbprint of the key the peer proved to hold, 32 bytes.
        now: seconds since the epoch.
        check: called as `check(grant_id, now)`; raises when that grant is revoked or unknown.

    Raises:
        GrantMissing: no presented grant covers this; `near_misses` lists the closest ones.
        GrantNotHeld, GrantNotYetValid, GrantExpired, GrantRevoked: one does, but is unusable.
        NameRefused: `name` is not an absolute name.
    """
    check_name(name)
    if right.bit_count() != 1:
        raise GrantMissing(f"{int(right)} is not one right")
    presented = tuple(grants)
    covering = {grant.id: grant for grant in presented if grant.covers(right, name)}
    if not covering:
        raise GrantMissing(
            f"no grant for {right.label} on {name}", near_misses(presented, right, name)
        )
    usable = _usable(covering, holder, now, check)
    restrictions = list(_restrictions(usable, right, name))
    return Decision(
        right=right,
        name=name,
        grants=usable,
        expires=min(grant.expires for grant in usable),
        restrictions=merge(restrictions),
        keep_when_stale=all(item is not None and item.keep_when_stale for item in restrictions),
    )


def near_misses(grants: Iterable[Grant], right: Right, name: str) -> tuple[str, ...]:
    """Permissions that nearly match, one line each: same name first, then same right."""
    pairs = [
        (link, permission)
        for grant in grants
        for link in grant.links
        for permission in link.permissions
    ]
    same_name = [
        f"grant {grant.short_id} gives {permission.rights.label}, not {right.label}, on {name}"
        for grant, permission in pairs
        if permission.matches(name, right) and right not in permission.rights
    ]
    same_right = [
        f"grant {grant.short_id} is for {permission.pattern}, not {name}"
        for grant, permission in pairs
        if right in permission.rights and not permission.matches(name, right)
    ]
    return tuple(dict.fromkeys([*same_name, *same_right]))[:MAX_NEAR_MISSES]


def _restrictions(grants: Iterable[Grant], right: Right, name: str) -> Iterator[Restriction | None]:
    """Those of every permission that covers the request, each in the layer of its link."""
    for grant in grants:
        for layer, link in enumerate(grant.links):
            for permission in link.permissions:
                if permission.covers(right, name):
                    restriction = permission.restriction
                    yield (
                        replace(restriction, layer=layer) if restriction and layer else restriction
                    )


def _usable(
    covering: dict[bytes, Grant], holder: bytes, now: int, check: RevocationCheck
) -> tuple[Grant, ...]:
    """The usable grants, by id; if there is none, raise the refusal after most checks."""
    usable: list[Grant] = []
    refusals: list[GrantError] = []
    for grant_id in sorted(covering):
        grant = covering[grant_id]
        try:
            _check(grant, holder, now, check)
        except GrantError as error:
            refusals.append(error)
        else:
            usable.append(grant)
    if not usable:
        raise max(refusals, key=_progress)
    return tuple(usable)


def _progress(error: GrantError) -> int:
    return _BY_PROGRESS.index(type(error))


def _check(grant: Grant, holder: bytes, now: int, check: RevocationCheck) -> None:
    if grant.holder != holder:
        raise GrantNotHeld(
            f"grant {grant.short_id} is bound to another key",
            f"it was issued to {grant.subject}; ask for one for the present key",
        )
    check_time(grant, now)
    try:
        for entry in grant.revocable:
            check(entry, now)
    except HintedError as error:
        raise GrantRevoked(f"grant {grant.short_id}: {error}", error.hint) from error
