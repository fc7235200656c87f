"""The publishers of lost sites, for the local subscribers that are connected to them. Pure.

A dead master ends nothing between nodes: they judge each other without it. Its names go, but a list
of publishers without them would make subscribers disconnect. So a list keeps the addresses until
the site has answered again, or is followed no longer.
"""

from collections.abc import Sequence

from rossec.master.state.imported_facts import Address


class KeptPublishers:
    """Addresses by site and topic."""

    def __init__(self) -> None:
        self._kept: dict[str, dict[str, Sequence[Address]]] = {}

    def keep(self, label: str, topic: str, found: Sequence[Address]) -> None:
        """Keep these of a topic, instead of those of the same site kept before."""
        if found:
            self._kept.setdefault(label, {})[topic] = found

    def forget(self, label: str) -> None:
        """Keep none of a site any more."""
        self._kept.pop(label, None)

    def topics(self, label: str) -> tuple[str, ...]:
        """The topics of which publishers of a site are kept."""
        return tuple(self._kept.get(label, ()))

    def addresses(self, topic: str) -> list[Address]:
        """The slave APIs of the kept publishers of a topic."""
        return [each for kept in self._kept.values() for each in kept.get(topic, ())]
