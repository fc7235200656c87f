"""What is taken from foreign domains into the own graph, as the list of domains says. Pure.

It is asked with every query, so another list counts at once, for what was imported before too. A
right decides on what it is used for: `subscribe` on the addresses of a topic's publishers, `call`
on that of a service, `param-get` on a mirrored parameter; to be seen in the graph, any right does.
"""

from collections.abc import Callable, Iterable

from ca.domains.aliases import REMOTE, split_alias
from ca.errors import NameRefused
from grants.model import ALL_RIGHTS, Right
from grants.reach import Reach

Rules = Callable[[str], Reach | None]
"""What is taken from the foreign domain with a label, as names there; None: all it shows."""


def everything(_label: str) -> None:
    """No rule for any domain."""


class Intake:
    """The rules for all foreign domains.

    Args:
        rules: of one domain, as of now.
    """

    def __init__(self, rules: Rules = everything) -> None:
        self.rules = rules

    def shows(self, name: str) -> bool:
        """Whether a topic, service or node of a foreign domain is taken; any other name is."""
        return self.gives(ALL_RIGHTS, name)

    def shows_node(self, alias: str, registered: Iterable[str]) -> bool:
        """Whether a foreign node is taken: its name is, or one that it is registered for."""
        return self.shows(alias) or any(map(self.shows, registered))

    def gives(self, rights: Right, name: str) -> bool:
        """Whether one of `rights` is taken on a name of a foreign domain; on any other it is."""
        if not name.startswith(REMOTE):
            return True
        try:
            found = split_alias(name)
        except NameRefused:
            return False
        if found is None:
            return True
        reach = self.rules(found[0])
        return reach is None or reach.covers_any(rights, found[1])
