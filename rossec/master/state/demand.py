"""What local nodes want of other masters: facts travel by need, as in the thesis (chapter 6). Pure.

Wanted is what local nodes subscribe, and for a minute what they looked up; a tool that lists the
graph wants everything for a minute. While a name is wanted its sites report changes, so a further
lookup is answered at once, also with no.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import Final

from ca.domains.aliases import is_alias
from ca.domains.served import served_name
from ca.errors import NameRefused
from rossec.master.state.registry import Kind, Registry
from rossec.master.state.sites import Site

WANTED_SECONDS: Final = 60
MAX_WANTED: Final = 4096  # names in one call; more is everything
MAX_WANTED_BYTES: Final = 256 * 1024
EVERYTHING: Final[tuple[str, ...]] = ()
NOTHING: Final = ("",)  # the empty name matches nothing


class Demand:
    """The names that local nodes want, as local names.

    Attributes:
        version: grows when more is wanted than before.
    """

    def __init__(self, registry: Registry) -> None:
        self.version = 0
        self._registry = registry
        self._asked: dict[str, int] = {}  # until when, the oldest first
        self._everything_until = 0

    def ask(self, name: str, now: int) -> None:
        """A local node has looked up, or subscribed, `name`."""
        if self._asked.pop(name, 0) <= now and not self._is_subscribed_by_others(name):
            self.version += 1
        self._asked[name] = now + WANTED_SECONDS
        while len(self._asked) > MAX_WANTED:
            del self._asked[next(iter(self._asked))]

    def ask_everything(self, now: int) -> None:
        """A local tool lists the graph."""
        if self._everything_until <= now:
            self.version += 1
        self._everything_until = now + WANTED_SECONDS

    def wanted(self, site: Site, now: int) -> tuple[str, ...]:
        """What to ask a site for: its names, sorted; `EVERYTHING` or `NOTHING`."""
        if now < self._everything_until:
            return EVERYTHING
        found = {name for name in map(site.origin, self._names(now)) if name is not None}
        if len(found) > MAX_WANTED or sum(map(len, found)) > MAX_WANTED_BYTES:
            return EVERYTHING
        return tuple(sorted(found)) or NOTHING

    def _names(self, now: int) -> Iterator[str]:
        for name in self._registry.keys(Kind.SUBSCRIBER):
            yield name
            if is_alias(name):  # a gateway registered at another master of the domain serves it too
                with suppress(NameRefused):
                    yield served_name(name)
        for name in [name for name, until in self._asked.items() if until <= now]:
            del self._asked[name]
        yield from self._asked

    def _is_subscribed_by_others(self, name: str) -> bool:
        return len(self._registry.registered_nodes(Kind.SUBSCRIBER, name)) > 1
