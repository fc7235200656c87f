"""The publishers to stay connected to while a restarted master receives registrations. Pure.

A restarted master knows the nodes that have registered since. Subscribers that reconnect first are
sent incomplete publisher lists, and disconnecting from the rest would interrupt topics that are
not affected. So after a session is opened, a publisher missing from the list is kept for `GRACE`
seconds, or until it is listed again; if it is removed after that, it is dropped at once. The grace
period begins with the loss of the session, and not again while a publisher is missing: a peer that
resets sessions cannot extend it. Whether a connection may stay open is decided elsewhere.
"""

from collections.abc import Callable, Iterable
from typing import Final

GRACE: Final = 15.0  # seconds; a hundred nodes register within six


class PublisherGrace:
    """The publishers of each topic of one node, by their URIs.

    Args:
        now: seconds of a monotonic clock (`rossec.clock.counter`).
    """

    def __init__(self, now: Callable[[], float]) -> None:
        self._now = now
        self._listed: dict[str, tuple[str, ...]] = {}
        self._missing: dict[str, frozenset[str]] = {}  # by topic; no empty sets
        self._until = 0.0

    def session_opened(self) -> None:
        """The session was lost and opened again: lists may be incomplete from now on."""
        now = self._now()
        if now >= self._until:
            self._missing.clear()
        if not self._missing:
            self._until = now + GRACE
        listed = self._listed.copy()  # atomic: in rospy threads share it
        for topic, uris in listed.items():
            if uris:
                self._missing[topic] = self._missing.get(topic, frozenset()).union(uris)

    def update(self, topic: str, uris: Iterable[str]) -> list[str]:
        """Take the master's list; returns the publishers to connect to."""
        self._listed[topic] = named = tuple(uris)
        missing = self._missing.pop(topic, frozenset()).difference(named)
        if missing:
            self._missing[topic] = missing
        return self.to_follow(topic)

    def to_follow(self, topic: str) -> list[str]:
        """The publishers the master lists, then missing ones still in their grace period."""
        named = self._listed.get(topic, ())
        missing = self._missing.get(topic, ()) if self._now() < self._until else ()
        return [*named, *sorted(set(missing).difference(named))]

    def expired_topics(self) -> list[str]:
        """Topics with publishers missing at the end of the grace period, each returned once."""
        if self._now() < self._until:
            return []
        topics, self._missing = list(self._missing), {}
        return topics

    def forget(self, topic: str) -> None:
        """Drop a topic that has no subscriber any more."""
        self._listed.pop(topic, None)
        self._missing.pop(topic, None)
