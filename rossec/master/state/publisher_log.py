"""Who published what, from when to when, for those who may know it only to a slot. Pure.

They are told who published at the beginning of the slot of the master's clock that is now, so what
they are told changes at the beginnings of slots alone (docs/spec/master.md). That is a function of
spans of time, so nothing is kept for a receiver. Only the own registrations are noted; a span is in
whole seconds, as slots are. What ended is kept for the longest slot, and bounded.
"""

from collections import OrderedDict
from collections.abc import Callable, Iterator
from typing import Final, NamedTuple

from grants.limits import MAX_SLOT
from rossec.master.state.registry import Kind, NodeRef, Registry

MAX_ENDED: Final = 16  # of one topic
MAX_TOPICS: Final = 512  # with publishers that have ended


class Published(NamedTuple):
    """A publisher of a topic, from the second `since` to the second `until`, both included."""

    node: NodeRef
    type: str
    since: int
    until: int | None = None


def _nothing_cut(_node: NodeRef) -> bool:
    return False


class PublisherLog:
    """The publishers of `registry`.

    Attributes:
        now: seconds since the epoch; set by whoever uses the log, before.
    """

    def __init__(self, registry: Registry) -> None:
        self._registry = registry
        self._current: dict[str, dict[NodeRef, Published]] = {}
        self._ended: OrderedDict[str, list[Published]] = OrderedDict()
        self.now = 0

    def __len__(self) -> int:
        return sum(map(len, (*self._current.values(), *self._ended.values())))

    def note(self, topic: str, is_cut: Callable[[NodeRef], bool] = _nothing_cut) -> None:
        """Note who publishes `topic` now; of one that is gone `is_cut` says whether it had to go.

        What a revocation or the end of a right has ended is in no later answer.
        """
        nodes = self._registry.registered_nodes(Kind.PUBLISHER, topic)
        known = self._current.get(topic, {})
        for node in known.keys() - set(nodes):
            published = known.pop(node)
            if not is_cut(node):
                self._keep(topic, published._replace(until=self.now))
        type_name = self._registry.topic_type(topic)
        for node in nodes:
            known.setdefault(node, Published(node, type_name, self.now))
        if known:
            self._current[topic] = known
        else:
            self._current.pop(topic, None)

    def at(self, topic: str, slot: int) -> list[Published]:
        """Who published `topic` at the beginning of the slot of so many seconds that is now."""
        self.note(topic)
        begin = self.now - self.now % slot
        ended = self._ended.get(topic, ())
        found = [each for each in ended if each.until is not None and each.until >= begin]
        found += self._current.get(topic, {}).values()
        return [each for each in found if each.since < begin]

    def ended_topics(self, name: str | None = None) -> Iterator[str]:
        """The topics that somebody, or the node `name`, published within the longest slot."""
        for topic, ended in tuple(self._ended.items()):
            if name is None or any(each.node.name == name for each in ended):
                yield topic

    def topics(self) -> list[str]:
        """All topics that are published, or were within the longest slot."""
        return list({**self._current, **self._ended})

    def _keep(self, topic: str, published: Published) -> None:
        self._ended.setdefault(topic, []).append(published)
        self._ended.move_to_end(topic)
        oldest = self.now - MAX_SLOT
        kept = [each for each in self._ended[topic] if (each.until or 0) >= oldest]
        self._ended[topic] = kept[-MAX_ENDED:]
        while len(self._ended) > MAX_TOPICS:
            self._ended.popitem(last=False)
