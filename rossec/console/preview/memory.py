"""The last minute of each topic that the console receives, in memory and nowhere else. Pure.

What is older than a minute is dropped, also where nothing new comes. Publishers choose size and
rate of their messages, so every number is bounded.
"""

from collections import deque
from collections.abc import Callable
from typing import Final, NamedTuple

from rossec.console.samples import Recorded

SECONDS: Final = 60
MAX_TOPICS: Final = 64
MAX_MESSAGES: Final = 600  # of one topic
MAX_TOPIC_SIZE: Final = 8 * 1024 * 1024  # bytes
MAX_SIZE: Final = 64 * 1024 * 1024


class PreviewMessage(NamedTuple):
    """A serialized message; `at` is when it was received, seconds since the epoch."""

    topic: str
    type: str
    at: float
    data: bytes


class PreviewMemory:
    """What was received within the last minute.

    Args:
        clock: seconds since the epoch.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock = clock
        self._topics: dict[str, deque[PreviewMessage]] = {}
        self._sizes: dict[str, int] = {}

    def add(self, message: PreviewMessage) -> None:
        """Keep a message; a topic whose type has changed begins anew."""
        self.drop_old()
        kept = self._topics.get(message.topic)
        if kept is None and len(self._topics) >= MAX_TOPICS:
            return
        if kept and kept[-1].type != message.type:
            self._forget(message.topic)
        self._topics.setdefault(message.topic, deque()).append(message)
        self._sizes[message.topic] = self._sizes.get(message.topic, 0) + len(message.data)
        self._limit(message.topic)

    def recorded(self, topic: str) -> Recorded | None:
        """The last minute of a topic; None if nothing came."""
        self.drop_old()
        kept = self._topics.get(topic)
        if not kept:
            return None
        messages = tuple((each.at, each.data) for each in kept)
        return Recorded(topic, kept[-1].type, messages)

    def drop_old(self) -> None:
        """Forget what is older than a minute."""
        begin = self._clock() - SECONDS
        for topic in tuple(self._topics):
            while topic in self._topics and self._topics[topic][0].at < begin:
                self._drop_oldest(topic)

    def _limit(self, topic: str) -> None:
        while topic in self._topics and (
            len(self._topics[topic]) > MAX_MESSAGES or self._sizes[topic] > MAX_TOPIC_SIZE
        ):
            self._drop_oldest(topic)
        while sum(self._sizes.values()) > MAX_SIZE:
            self._drop_oldest(max(self._sizes, key=self._sizes.__getitem__))

    def _drop_oldest(self, topic: str) -> None:
        self._sizes[topic] -= len(self._topics[topic].popleft().data)
        if not self._topics[topic]:
            self._forget(topic)

    def _forget(self, topic: str) -> None:
        del self._topics[topic], self._sizes[topic]
