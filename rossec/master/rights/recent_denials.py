"""The rights that nodes lacked within the last day, for a person to look at. Pure, in memory.

Each right on a name counts once for a node, with the newest time and name: one run of an anonymous
node is as the next. Nodes choose the names, so the
number is bounded, for each certified name and in all; where the whole is full, the node with most
entries loses its oldest: no node pushes out what another was denied, unless many do it together.
"""

from collections import OrderedDict
from typing import Final, NamedTuple

from grants.basics import is_dispensable, own_form
from grants.model import Right

KEPT: Final = 24 * 3600  # seconds
MAX_DENIALS: Final = 1000
MAX_OF_NODE: Final = 200
MAX_NAME: Final = 255  # characters; a longer one is cut


class RecentDenial(NamedTuple):
    """A right that a node lacked on a name, when it last asked."""

    at: int
    node: str
    right: Right
    name: str


class RecentDenials:
    """The newest denials of all nodes."""

    def __init__(self) -> None:
        self._nodes: dict[str, OrderedDict[tuple[Right, str], tuple[int, str]]] = {}
        self._count = 0

    def add(self, now: int, node: str, right: Right, name: str) -> None:
        """Record a denial, unless of what every program asks for and works without."""
        own = own_form(node, name)
        if is_dispensable(right, own):
            return
        denials = self._nodes.setdefault(node, OrderedDict())
        key = right, own[:MAX_NAME]
        if denials.pop(key, None) is None:
            self._count += 1
        denials[key] = now, name[:MAX_NAME]
        if len(denials) > MAX_OF_NODE:
            self._forget_oldest(node)
        while self._count > MAX_DENIALS:
            self._forget_oldest(max(self._nodes, key=lambda each: len(self._nodes[each])))

    def newest_first(self, now: int) -> list[RecentDenial]:
        """The denials of the last day."""
        self._drop_old(now)
        found = [
            RecentDenial(at, node, right, name)
            for node, denials in self._nodes.items()
            for (right, _), (at, name) in denials.items()
        ]
        return sorted(found, key=lambda denial: (-denial.at, denial[1:]))

    def _drop_old(self, now: int) -> None:
        for node in tuple(self._nodes):
            while node in self._nodes and now - next(iter(self._nodes[node].values()))[0] > KEPT:
                self._forget_oldest(node)

    def _forget_oldest(self, node: str) -> None:
        self._nodes[node].popitem(last=False)
        self._count -= 1
        if not self._nodes[node]:
            del self._nodes[node]
