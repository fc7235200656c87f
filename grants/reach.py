"""What some permissions reach, prepared for being asked often: the master asks for every name.

The answer is that of `Permission.covers`, permission by permission; only the work is done before.
A name in the syntax of `ca.names` is compared whole, or with what stands before a last `**`, in C.
Of parameters a whole namespace can be asked about, so that nobody need list what is in it.
"""

from bisect import bisect_left
from collections.abc import Iterable

from ca.errors import NameRefused
from ca.names import check_name
from grants import names
from grants.model import TREE_RIGHTS, Permission, Right


class Reach:
    """For each right the exact names, the beginnings of names, and the other permissions."""

    __slots__ = ("_any", "_by_right")

    def __init__(self, permissions: Iterable[Permission]) -> None:
        held = tuple(permissions)
        shared: dict[Sorted, Sorted] = {}  # many rights mostly reach the same
        found = {int(right): _sorted(held, right) for right in Right}
        self._by_right = {right: shared.setdefault(each, each) for right, each in found.items()}
        self._any: dict[int, Sorted] = {}

    def covers(self, right: Right, name: str) -> bool:
        """Whether some permission gives `right`, exactly one, on `name`; what is no name: no."""
        found = self._by_right.get(int(right))
        return found is not None and _covers(found, name)

    def covers_any(self, rights: Right, name: str) -> bool:
        """Whether one of `rights`, any number of them, is given on `name`; what is no name: no."""
        found = self._any.get(int(rights))
        if found is None:
            found = self._any[int(rights)] = _joined(
                self._by_right[int(right)] for right in Right if right in rights
            )
        return _covers(found, name)

    def covers_below(self, right: Right, space: str) -> bool:
        """Whether `right`, one of parameters, is given on every name below `space`.

        Args:
            space: a name, or `/`: every name there is.
        """
        found = self._of_tree(right)
        return found is not None and (
            _beginning(space).startswith(found[1])
            or any(names.covers_below(permission.pattern, space) for _, permission in found[2])
        )

    def touches(self, right: Right, space: str) -> bool:
        """Whether `right`, one of parameters, is given on `space` or on any name below it.

        Args:
            space: as for `covers_below`.
        """
        found = self._of_tree(right)
        return found is not None and (
            _touches(_beginning(space), found[1])
            or any(names.touches(permission.pattern, space) for _, permission in found[2])
        )

    def patterns(self, right: Right) -> int:
        """How many patterns are asked one by one: what a question about `right` costs."""
        found = self._by_right.get(int(right))
        return 0 if found is None else len(found[2])

    def _of_tree(self, right: Right) -> "Sorted | None":
        return self._by_right.get(int(right)) if right & TREE_RIGHTS else None


Sorted = tuple[frozenset[str], tuple[str, ...], tuple[tuple[Right, Permission], ...]]


def _covers(found: Sorted, name: str) -> bool:
    exact, beginnings, others = found
    if name in exact:  # a pattern that is a name
        return True
    begins = name.startswith(beginnings)
    if not begins and not others:
        return False
    try:
        check_name(name)
    except NameRefused:
        return False
    return begins or any(permission.covers(right, name) for right, permission in others)


def _beginning(space: str) -> str:
    return space if space == "/" else f"{space}/"


def _touches(space: str, beginnings: tuple[str, ...]) -> bool:
    """Whether one of the sorted `beginnings` lies at, above or below `space`; all end with `/`."""
    if space.startswith(beginnings):
        return True
    at = bisect_left(beginnings, space)
    return at < len(beginnings) and beginnings[at].startswith(space)


def _joined(parts: Iterable[Sorted]) -> Sorted:
    exact, beginnings, others = set[str](), set[str](), list[tuple[Right, Permission]]()
    for part in parts:
        exact |= part[0]
        beginnings.update(part[1])
        others += part[2]
    return frozenset(exact), tuple(sorted(beginnings)), tuple(others)


def _sorted(permissions: tuple[Permission, ...], right: Right) -> Sorted:
    exact, beginnings, others = set(), set(), []
    for permission in permissions:
        if right not in permission.rights:
            continue
        plain = permission.pattern.removesuffix("/**")
        if "*" in plain:
            others.append((right, permission))
        elif plain != permission.pattern:
            beginnings.add(f"{plain}/")
        else:
            exact.add(plain)
            if right in TREE_RIGHTS:
                beginnings.add(f"{plain}/")
    return frozenset(exact), tuple(sorted(beginnings)), tuple(others)
