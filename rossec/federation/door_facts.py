"""Facts of a site behind a relay, with the relay's doors for the addresses it says. Pure.

The addresses are of another network. A node or service has none here until its door is open, and
another one when the relay was started again; a door that is gone counts until there is another, or
each restart of the relay would take all publishers from their subscribers for a moment. What the
site says is checked before a door is wanted.
"""

from collections.abc import Callable, Iterable, Iterator
from typing import Final

from rossec.errors import ImportRefused
from rossec.federation.answers import SiteChange
from rossec.master.state.doors import NODE, SERVICE, Door, Target
from rossec.master.state.imported_facts import FACTS_LIMIT, Fact, checked, parts
from rossec.master.state.sites import NODE as NODE_FACT
from rossec.master.state.sites import PROVIDER
from rossec.ros.settings import build_door, build_uri

_KINDS: Final = {NODE_FACT: NODE, PROVIDER: SERVICE}

FindDoor = Callable[[Target], Door | None]


class DoorFacts:
    """What one site says, as far as it concerns addresses.

    Args:
        peer: the relay's label of the site.
        find: the door of a target now.
    """

    def __init__(self, peer: str, find: FindDoor) -> None:
        self._peer = peer
        self._find = find
        self._said: set[Fact] = set()
        self._doors: dict[Target, Door] = {}
        self._shown: set[Fact] = set()

    @property
    def targets(self) -> set[Target]:
        """All that needs a door."""
        return {self._target(fact) for fact in self._said}

    def take(self, change: SiteChange) -> Iterator[None]:
        """Take what the site says of addresses; yields where other work may be done.

        Raises:
            ImportRefused: a malformed fact, or too many; nothing is taken.
        """
        said = set[Fact]() if change.whole else self._said - change.removed
        for part in parts(change.added):
            said.update(fact for fact in checked(part) if fact[0] in _KINDS)
            yield
        if len(said) > FACTS_LIMIT:
            raise ImportRefused(f"more than {FACTS_LIMIT} addresses of {self._peer}")
        self._said = said

    def shown(self, change: SiteChange) -> SiteChange:
        """`change` with doors for addresses: those of now, and those that others had before."""
        self._look()
        doors = {self._door_fact(fact) for fact in self._said if self._target(fact) in self._doors}
        added = _without_addresses(change.added) | (doors if change.whole else doors - self._shown)
        removed = _without_addresses(change.removed) | (self._shown - doors)
        self._shown = doors
        return change._replace(added=frozenset(added), removed=frozenset(removed))

    def forget(self) -> None:
        """The site's facts are dropped."""
        self._said, self._doors, self._shown = set(), {}, set()

    def _look(self) -> None:
        """Find the doors of now; one that is gone is kept unless its place is another's."""
        targets = self.targets
        found = {target: door for target in targets if (door := self._find(target)) is not None}
        taken = set(found.values())
        kept = self._doors.items()
        old = {target: door for target, door in kept if target in targets and door not in taken}
        self._doors = {**old, **found}

    def _target(self, fact: Fact) -> Target:
        return Target(self._peer, _KINDS[fact[0]], fact[1])

    def _door_fact(self, fact: Fact) -> Fact:
        kind, name, _ = fact
        door = self._doors[self._target(fact)]
        if kind == NODE_FACT:
            return kind, name, build_door(*door)
        return kind, name, build_uri(*door, scheme="rosrpc").removesuffix("/")


def _without_addresses(facts: Iterable[Fact]) -> set[Fact]:
    return {fact for fact in facts if fact[0] not in _KINDS}
