"""What happens to the facts of other masters, for subscribers, the audit and people. Pure."""

from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from typing import Final

from ca.domains.aliases import is_alias
from rossec.master.state.imported_facts import Fact, SiteFacts
from rossec.master.state.registry import ANY_TYPE, PublishersChanged, Registry
from rossec.master.state.sites import TYPE, Site

MAX_REPORTED: Final = 1024  # contradictions of one site that are reported


@dataclass(frozen=True)
class TypeContradicted:
    """A topic is not imported from a site, where it has another type than here."""

    label: str
    topic: str
    type_here: str
    type_there: str


ImportEvent = PublishersChanged | TypeContradicted


@dataclass(frozen=True)
class SiteStatus:
    """One site, for people; `topics` returns those with publishers or subscribers there."""

    site: Site
    facts: int
    is_lost: bool
    topics: Callable[[], list[str]]


class Contradictions:
    """The topics that a site gives another type than they have here: each is reported once."""

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._reported: dict[str, set[str]] = {}

    def forget(self, label: str) -> None:
        """Forget what was reported of a site."""
        self._reported.pop(label, None)

    def report(self, held: SiteFacts, facts: Iterable[Fact]) -> list[TypeContradicted]:
        """Those among `facts`, as far as not reported before."""
        label, events = held.site.label, list[TypeContradicted]()
        reported = self._reported.setdefault(label, set())
        for kind, name, there in facts:
            topic = held.local_key(name) if kind == TYPE else None
            if topic is None or is_alias(topic):  # of an alias the origin's type counts
                continue
            here = self._registry.topic_type(topic)
            if here in (ANY_TYPE, there) or topic in reported:
                continue
            if len(reported) < MAX_REPORTED:
                reported.add(topic)
                events.append(TypeContradicted(label, topic, here, there))
        return events


def finished(steps: Generator[None, None, list[ImportEvent]]) -> list[ImportEvent]:
    """Take all steps at once; returns their events."""
    while True:
        try:
            next(steps)
        except StopIteration as end:
            events: list[ImportEvent] = end.value
            return events
