"""Topics whose connection ended, and when to resubscribe. Pure.

rospy drops a connection that ended until it gets a publisherUpdate; the sidecar sends one once it
holds a grant again. The delay doubles while connections keep ending soon (exponential backoff).
"""

from collections.abc import Callable
from typing import Final

FIRST_DELAY: Final = 1.0
MAX_DELAY: Final = 32.0


class ResubscribeQueue:
    """The topics of one identity to resubscribe; times are seconds of one clock."""

    def __init__(self) -> None:
        self._due: dict[str, float] = {}
        self._delays: dict[str, float] = {}

    def add(self, topic: str, began: float, now: float) -> None:
        """A connection for `topic`, made at `began`, has ended."""
        lasted = now - began > MAX_DELAY
        delay = FIRST_DELAY if lasted else self._delays.get(topic, FIRST_DELAY)
        self._due[topic] = now + delay
        self._delays[topic] = min(2 * delay, MAX_DELAY)

    def take_due(self, now: float, may_subscribe: Callable[[str], bool]) -> list[str]:
        """The topics that are due; one without a grant waits until there is one."""
        due = [topic for topic, at in self._due.items() if at <= now and may_subscribe(topic)]
        for topic in due:
            del self._due[topic]
        return due
