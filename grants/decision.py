"""Authorization: may the holder of a key use a right on a name now, and under which restrictions?

Every grant the peer presented is evaluated. The limit of this: a peer presents only the grants it chooses, so
to narrow a right for good the wider grant must be revoked. Of a chain (`grants.token`) every link must
authorize alone.
"""

from bisect import bisect_left
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

from ca import names
from ca.errors import HintedError, NameRefused
from ca.names import TAIL, check_name
from grants.errors import GrantError, GrantExpired, GrantMissing, GrantNotHeld, GrantNotYetValid, GrantRevoked
from grants.model import TREE_RIGHTS, Grant, Permission, Restriction, Right, check_time, format_time, merge

RevocationCheck = Callable[[bytes, int], None]

MAX_NEAR_MISSES: Final = 5

# Of several unusable grants the one that passed most checks explains the refusal.
_BY_PROGRESS: Final = (GrantNotHeld, GrantNotYetValid, GrantExpired, GrantRevoked)


@dataclass(frozen=True)
class Decision:
    """Authorized until `expires`, under `restrictions`."""

    right: Right
    name: str
    grants: tuple[Grant, ...]  # the usable ones that cover the request, ordered by id
    expires: int  # the earliest end of these, seconds since the epoch
    restrictions: tuple[Restriction, ...]  # all that must be applied, by a `Guard`
    keep_when_stale: bool = False  # whether every one of the permissions says so

    @property
    def grant_ids(self) -> tuple[bytes, ...]:
        more = (entry for grant in self.grants for entry in grant.revocable[1:])
        return (*(grant.id for grant in self.grants), *dict.fromkeys(more))

    @property
    def pad(self) -> int:
        """What is sent is padded to a multiple of so many bytes; 0: it is not."""
        return max((each.pad or 0 for each in self.restrictions), default=0)

    def require_unrestricted(self) -> None:
        """Return if there are no restrictions: for callers that have no message to apply them to."""
        if self.restrictions:
            raise GrantError(
                f"{self.right.label} on {self.name} is granted with restrictions that cannot be applied here",
                "ask for a grant without conditions and filters",
            )

    def explain(self) -> list[str]:
        """The decision as text, line by line."""
        lines = [f"{self.right.label} {self.name} until {format_time(self.expires)}"]
        lines += [f"grant {grant.short_id} to {grant.subject}" for grant in self.grants]
        lines += [line for restriction in self.restrictions for line in restriction.lines()]
        return lines if self.restrictions else [*lines, "no restrictions"]


def authorize(
    grants: Iterable[Grant], right: Right, name: str, *, holder: bytes, now: int, check: RevocationCheck
) -> Decision:
    """Decide whether the key with the thumbprint `holder` may use one right on a name.

    `grants` are verified, as presented by the peer. `check(grant_id, now)` raises when that grant is
    revoked or unknown; `now` is in seconds since the epoch.
    """
    check_name(name)
    if right.bit_count() != 1:
        raise GrantMissing(f"{int(right)} is not one right")
    # The points of docs/spec/grant.md, section 4. 1: of the grants that cover the name, those are usable that
    # are the peer's own, valid and not revoked; 5: a chain covers only what every link does.
    presented = tuple(grants)
    covering = {grant.id: grant for grant in presented if grant.covers(right, name)}
    if not covering:
        raise GrantMissing(f"no grant for {right.label} on {name}", near_misses(presented, right, name))
    usable: list[Grant] = []
    refusals: list[GrantError] = []
    for _, grant in sorted(covering.items()):  # by id: the decision is the same in whatever order they came
        try:
            _check(grant, holder, now, check)
            usable.append(grant)
        except GrantError as error:
            refusals.append(error)
    if not usable:
        raise max(refusals, key=lambda error: _BY_PROGRESS.index(type(error)))
    # 2: the restrictions of all covering entries apply together, those of a chain link by link. If the first,
    # the last or the widest won instead, the answer would depend on the order, or adding a grant would
    # silently widen a right that was narrowed on purpose.
    restrictions: list[Restriction | None] = []
    for layer, link in ((at, link) for grant in usable for at, link in enumerate(grant.links)):
        covers = (each.restriction for each in link.permissions if each.covers(right, name))
        restrictions += (replace(each, layer=layer) if each and layer else each for each in covers)
    # 3: the right ends with the first of these grants. 4: one that does not say "keep" lets none survive.
    return Decision(
        right=right,
        name=name,
        grants=tuple(usable),
        expires=min(grant.expires for grant in usable),
        restrictions=merge(restrictions),
        keep_when_stale=all(item is not None and item.keep_when_stale for item in restrictions),
    )


def near_misses(grants: Iterable[Grant], right: Right, name: str) -> tuple[str, ...]:
    pairs = [(link, each) for grant in grants for link in grant.links for each in link.permissions]
    same_name = [
        f"grant {grant.short_id} gives {each.rights.label}, not {right.label}, on {name}"
        for grant, each in pairs
        if each.matches(name, right) and right not in each.rights
    ]
    same_right = [
        f"grant {grant.short_id} is for {each.pattern}, not {name}"
        for grant, each in pairs
        if right in each.rights and not each.matches(name, right)
    ]
    return tuple(dict.fromkeys([*same_name, *same_right]))[:MAX_NEAR_MISSES]


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


class Reach:
    """For each right the exact names, the prefixes of names, and the other permissions.

    The answer is that of `Permission.covers` for any of the permissions, and of `Grant.covers` for
    `chains`, in which every link must cover the name; only the work is done before. A name is compared
    whole, or with the prefix before a final `**`, in C.
    """

    __slots__ = ("_any", "_by_right", "_by_slot", "_chains", "_given", "_slot", "has_slots")

    def __init__(self, permissions: Iterable[Permission], chains: Iterable[Sequence["Reach"]] = ()) -> None:
        given = tuple(permissions)
        self._chains = tuple(tuple(links) for links in chains)
        self._given: bool = bool(given or self._chains)
        slots = {_slot(permission) for permission in given}
        self._slot = min(slots, default=0)  # of all, unless they are apart in `_by_slot`
        self._by_slot = tuple(
            Reach(each for each in given if _slot(each) == slot) for slot in slots if len(slots) > 1
        )
        linked = (link.has_slots for links in self._chains for link in links)
        self.has_slots: bool = any(slots) or any(linked)
        shared: dict[_NameSets, _NameSets] = {}  # many rights mostly have equal sets
        sets = {int(right): _name_sets(given, right) for right in Right}
        self._by_right = {right: shared.setdefault(each, each) for right, each in sets.items()}
        self._any: dict[int, _NameSets] = {}

    @classmethod
    def of(cls, grants: Iterable[Grant]) -> "Reach":
        """What verified grants of one key give, chains among them."""
        held = tuple(grants)
        return cls(
            (each for grant in held if not grant.chain for each in grant.permissions),
            ([cls(link.permissions) for link in grant.chain] for grant in held if grant.chain),
        )

    @property
    def is_empty(self) -> bool:
        return not self._given

    def covers(self, right: Right, name: str) -> bool:
        """Whether some permission gives the single `right` on `name`; False for an invalid name."""
        sets = self._by_right.get(int(right))
        return (sets is not None and _covers(sets, name)) or any(
            all(link.covers(right, name) for link in links) for links in self._chains
        )

    def covers_any(self, rights: Right, name: str) -> bool:
        """Whether one of `rights` is given on `name`; False for an invalid name."""
        sets = self._any.get(int(rights))
        if sets is None:
            parts = (self._by_right[int(right)] for right in Right if right in rights)
            exact, prefixes, others = set[str](), set[str](), list[tuple[Right, Permission]]()
            for part in parts:
                exact |= part[0]
                prefixes.update(part[1])
                others += part[2]
            sets = self._any[int(rights)] = frozenset(exact), tuple(sorted(prefixes)), tuple(others)
        return _covers(sets, name) or any(map(bool, self._linked(rights, name)))

    def slot(self, rights: Right, name: str) -> int:
        """The shortest slot in which one of `rights` is given on `name`; 0: one is without.

        Only what gives the right to subscribe alone is in slots. Of a chain the longest counts.
        """
        if not self.has_slots:
            return 0
        found = [part.slot(rights, name) for part in self._by_slot if part.covers_any(rights, name)]
        single = (self._by_right[int(right)] for right in Right if right in rights)
        if not self._by_slot and any(_covers(sets, name) for sets in single):
            found.append(self._slot)
        for links in self._linked(rights, name):
            found += [max(link.slot(rights, name) for link in links)]
        return min(found, default=0)

    def _linked(self, rights: Right, name: str) -> Iterator[Sequence["Reach"]]:
        single = [right for right in Right if right in rights]
        for links in self._chains:
            if any(all(link.covers(right, name) for link in links) for right in single):
                yield links

    def covers_below(self, right: Right, namespace: str) -> bool:
        """Whether `right`, one of parameters, is given on every name below `namespace`, a name or `/`."""
        sets = self._parameter_sets(right)
        if any(all(link.covers_below(right, namespace) for link in links) for links in self._chains):
            return True
        return sets is not None and (
            _prefix(namespace).startswith(sets[1])
            or any(names.covers_below(permission.pattern, namespace) for _, permission in sets[2])
        )

    def touches(self, right: Right, namespace: str) -> bool:
        """Whether `right`, one of parameters, is given on `namespace` or on any name below it.

        A chain may touch it by each link and yet give nothing: who asks filters name by name.
        """
        sets = self._parameter_sets(right)
        if any(all(link.touches(right, namespace) for link in links) for links in self._chains):
            return True
        if sets is None:
            return False
        prefix, prefixes = _prefix(namespace), sets[1]
        at = bisect_left(prefixes, prefix)
        below = at < len(prefixes) and prefixes[at].startswith(prefix)
        return (
            below
            or prefix.startswith(prefixes)
            or any(names.touches(each.pattern, namespace) for _, each in sets[2])
        )

    def patterns(self, right: Right) -> int:
        """The number of patterns compared one by one: the cost of a check of `right`."""
        sets = self._by_right.get(int(right))
        links = (link.patterns(right) for chain in self._chains for link in chain)
        return (0 if sets is None else len(sets[2])) + sum(links) + len(self._chains)

    def _parameter_sets(self, right: Right) -> "_NameSets | None":
        return self._by_right.get(int(right)) if right & TREE_RIGHTS else None


def _slot(permission: Permission) -> int:
    restriction = permission.restriction
    if restriction is None or permission.rights != Right.SUBSCRIBE:
        return 0
    return restriction.slot or 0


_NameSets = tuple[frozenset[str], tuple[str, ...], tuple[tuple[Right, Permission], ...]]


def _covers(sets: _NameSets, name: str) -> bool:
    exact, prefixes, others = sets
    if name in exact:  # a pattern without wildcards
        return True
    has_prefix = name.startswith(prefixes)
    if not has_prefix and not others:
        return False
    try:
        check_name(name)
    except NameRefused:
        return False
    return has_prefix or any(permission.covers(right, name) for right, permission in others)


def _prefix(namespace: str) -> str:
    return namespace if namespace == "/" else f"{namespace}/"


def _name_sets(permissions: tuple[Permission, ...], right: Right) -> _NameSets:
    exact, prefixes, others = set(), set(), []
    for permission in permissions:
        if right not in permission.rights:
            continue
        plain = permission.pattern.removesuffix("/**")
        if "*" in plain or TAIL in plain:
            others.append((right, permission))
        elif plain != permission.pattern:
            prefixes.add(f"{plain}/")
        else:
            exact.add(plain)
            if right in TREE_RIGHTS:
                prefixes.add(f"{plain}/")
    return frozenset(exact), tuple(sorted(prefixes)), tuple(others)


def check_tail(grant: Grant, peer: str, *, tail: bool) -> None:
    """Return if `grant` has no tail patterns, or the peer has the tail they are about.

    A grant to `/rviz` may say `/rviz~/get_loggers`: for `/rviz` and for each name that its wildcard tail
    covers (ADR 0007). It counts only while the peer, by its certified name here, proves that it is this
    node and has the tail: else names beside its own could be certified for other keys. A foreigner's
    certificate never has one here.
    """
    if not any(link.has_tail_patterns for link in grant.links):
        return
    if grant.chain or not tail or grant.subject != peer:
        raise GrantNotHeld(
            f"grant {grant.short_id} is for the anonymous nodes of {grant.subject}",
            f"its certificate must have a wildcard tail: rossec ca sign FILE --anonymous, and for"
            f" {grant.subject} itself a grant of its own",
        )
