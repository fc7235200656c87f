"""Connections to publishers of other origins, which end when the master lists those no longer.

What a gateway serves replaces the origin's publishers, and the reverse. roscpp and the built-in
node leave a publisher that is listed no longer; rospy never does, and would get every message
twice, over one line more. So its connections are ended for it. Topics of the own domain are left as
ROS has them. Thread-safe; a connection is ended with no lock held.
"""

from collections.abc import Callable
from threading import Lock
from typing import Final, Generic, TypeVar

from ca.domains.aliases import is_alias
from rossec.participant.authorized import PeerStream

PERIOD: Final = 1.0  # seconds, at most, from the master's list to the end of a connection
_REASON: Final = "the master lists this publisher no longer"

PublisherT = TypeVar("PublisherT")


class FollowedPublishers(Generic[PublisherT]):
    """The connections of one identity to publishers of aliases.

    Args:
        is_listed: whether the master lists a publisher of a topic, or may list it again.
    """

    def __init__(self, is_listed: Callable[[str, PublisherT], bool]) -> None:
        self._is_listed = is_listed
        self._lock = Lock()
        self._followed: dict[PeerStream, tuple[str, PublisherT]] = {}

    def add(self, stream: PeerStream, topic: str, publisher: PublisherT) -> None:
        """A connection to a publisher of `topic`; `discard` when it has ended."""
        if is_alias(topic):
            with self._lock:
                self._followed[stream] = topic, publisher

    def discard(self, stream: PeerStream) -> None:
        """Forget a connection, also one that was never added."""
        with self._lock:
            self._followed.pop(stream, None)

    def leave_unlisted(self) -> None:
        """End the connections to publishers that are not listed."""
        with self._lock:
            followed = tuple(self._followed.items())
        for stream, (topic, publisher) in followed:
            if not self._is_listed(topic, publisher):
                self.discard(stream)
                stream.abort(_REASON)
