"""The publishers to follow, while a master learns anew who there is. Pure but for a given clock.

A master that was started again knows who has registered with it since. Subscribers that are back
first are told of fewer publishers than there are, and hanging up on the others would interrupt what
nothing has happened to. So after a session is opened anew, a publisher that is missing from the
lists is followed for `GRACE` more, or until it is named again; what is then taken away is gone at
once. The time begins with a loss, and not again while anybody is missing: whoever resets sessions
keeps nobody alive. Whether a connection may live is judged elsewhere, as ever.
"""

from collections.abc import Callable, Iterable
from typing import Final

GRACE: Final = 15.0  # seconds; a hundred nodes are back within six


class PublisherGrace:
    """The publishers of each topic of one node, by their URIs.

    Args:
        now: seconds of a clock that nobody sets, nor corrects (`rossec.clock.counter`).
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._named: dict[str, tuple[str, ...]] = {}
        self._missing: dict[str, frozenset[str]] = {}  # by topic; none are empty
        self._until = 0.0

    def session_opened(self) -> None:
        """There was a loss, and lists may be incomplete from now on."""
        now = self._now()
        if now >= self._until:
            self._missing.clear()
        if not self._missing:
            self._until = now + GRACE
        for topic, uris in self._named.copy().items():  # in one step: threads share this in rospy
            if uris:
                self._missing[topic] = self._missing.get(topic, frozenset()).union(uris)

    def update(self, topic: str, uris: Iterable[str]) -> list[str]:
        """The master names these; returns those to follow."""
        self._named[topic] = named = tuple(uris)
        missing = self._missing.pop(topic, frozenset()).difference(named)
        if missing:
            self._missing[topic] = missing
        return self.to_follow(topic)

    def to_follow(self, topic: str) -> list[str]:
        """Those the master names, then those it may have yet to name."""
        named = self._named.get(topic, ())
        missing = self._missing.get(topic, ()) if self._now() < self._until else ()
        return [*named, *sorted(set(missing).difference(named))]

    def expired_topics(self) -> list[str]:
        """Topics with publishers that were missing until their time was over; each is told once."""
        if self._now() < self._until:
            return []
        topics, self._missing = list(self._missing), {}
        return topics

    def forget(self, topic: str) -> None:
        """Nobody subscribes to it any more."""
        self._named.pop(topic, None)
        self._missing.pop(topic, None)
