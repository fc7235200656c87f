"""An index over the names that permissions cover: the master checks every name with it.

The answer is that of `Permission.covers` for any of the permissions, and of `Grant.covers` for
chains, in which every link must cover the name; only the work is done before.
A name in the syntax of `ca.names` is compared whole, or with the prefix before a final `**`, in C.
For parameters a whole namespace can be checked, without a list of the names in it.
"""

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Sequence

from ca import patterns
from ca.errors import NameRefused
from ca.names import check_name
from ca.patterns import TAIL
from grants.model import TREE_RIGHTS, Grant, Permission, Right


class Reach:
    """For each right the exact names, the prefixes of names, and the other permissions.

    Args:
        permissions: any of them gives a right.
        chains: the reaches of the links of each chain: all of them together give a right.
    """

    __slots__ = ("_any", "_by_right", "_by_slot", "_chains", "_given", "_slot", "has_slots")

    def __init__(
        self, permissions: Iterable[Permission], chains: Iterable[Sequence["Reach"]] = ()
    ) -> None:
        given = tuple(permissions)
        self._chains = tuple(tuple(links) for links in chains)
        self._given: bool = bool(given or self._chains)
        slots = {_slot(permission) for permission in given}
        self._slot = min(slots, default=0)  # of all, unless they are apart in `_by_slot`
        self._by_slot = tuple(
            Reach(each for each in given if _slot(each) == slot)
            for slot in slots if len(slots) > 1
        )  # fmt: skip
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
        """Whether there is no grant at all."""
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
            sets = self._any[int(rights)] = _union(
                self._by_right[int(right)] for right in Right if right in rights
            )
        return _covers(sets, name) or any(map(bool, self._linked(rights, name)))

    def slot(self, rights: Right, name: str) -> int:
        """The shortest slot in which one of `rights` is given on `name`; 0: one is without.

        Only what gives the right to subscribe alone is in slots. Of a chain the longest counts.
        """
        if not self.has_slots:
            return 0
        found = [part.slot(rights, name) for part in self._by_slot if part.covers_any(rights, name)]
        if not self._by_slot and self._covers_itself(rights, name):
            found.append(self._slot)
        for links in self._linked(rights, name):
            found += [max(link.slot(rights, name) for link in links)]
        return min(found, default=0)

    def _covers_itself(self, rights: Right, name: str) -> bool:
        return any(_covers(self._by_right[int(right)], name) for right in Right if right in rights)

    def _linked(self, rights: Right, name: str) -> Iterator[Sequence["Reach"]]:
        """The chains that give one of `rights`: all links give the same."""
        single = [right for right in Right if right in rights]
        for links in self._chains:
            if any(all(link.covers(right, name) for link in links) for right in single):
                yield links

    def covers_below(self, right: Right, namespace: str) -> bool:
        """Whether `right`, one of parameters, is given on every name below `namespace`.

        Args:
            namespace: a name, or `/` for all names.
        """
        sets = self._parameter_sets(right)
        if any(
            all(link.covers_below(right, namespace) for link in links) for links in self._chains
        ):
            return True
        return sets is not None and (
            _prefix(namespace).startswith(sets[1])
            or any(
                patterns.covers_below(permission.pattern, namespace) for _, permission in sets[2]
            )
        )

    def touches(self, right: Right, namespace: str) -> bool:
        """Whether `right`, one of parameters, is given on `namespace` or on any name below it.

        A chain may touch it by each link and yet give nothing: who asks filters name by name.

        Args:
            namespace: as for `covers_below`.
        """
        sets = self._parameter_sets(right)
        if any(all(link.touches(right, namespace) for link in links) for links in self._chains):
            return True
        return sets is not None and (
            _touches(_prefix(namespace), sets[1])
            or any(patterns.touches(permission.pattern, namespace) for _, permission in sets[2])
        )

    def patterns(self, right: Right) -> int:
        """The number of patterns compared one by one: the cost of a check of `right`."""
        sets = self._by_right.get(int(right))
        links = (link.patterns(right) for chain in self._chains for link in chain)
        return (0 if sets is None else len(sets[2])) + sum(links) + len(self._chains)

    def _parameter_sets(self, right: Right) -> "_NameSets | None":
        return self._by_right.get(int(right)) if right & TREE_RIGHTS else None


def _slot(permission: Permission) -> int:
    """The slot of a permission that gives nothing but to subscribe; 0: it has none."""
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


def _touches(namespace: str, prefixes: tuple[str, ...]) -> bool:
    """Whether one of the sorted `prefixes` is at, above or below `namespace`; all end in `/`."""
    if namespace.startswith(prefixes):
        return True
    at = bisect_left(prefixes, namespace)
    return at < len(prefixes) and prefixes[at].startswith(namespace)


def _union(parts: Iterable[_NameSets]) -> _NameSets:
    exact, prefixes, others = set[str](), set[str](), list[tuple[Right, Permission]]()
    for part in parts:
        exact |= part[0]
        prefixes.update(part[1])
        others += part[2]
    return frozenset(exact), tuple(sorted(prefixes)), tuple(others)


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
