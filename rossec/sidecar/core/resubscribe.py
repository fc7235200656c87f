"""Topics whose connection ended, and when the program is to try again. Pure.

rospy gives up a connection that ended, until the master names the publisher anew; so the sidecar
does, once it can prove the right again. A connection that soon ends again is waited for longer.
"""

from collections.abc import Callable
from typing import Final

FIRST_PAUSE: Final = 1.0
LONGEST_PAUSE: Final = 32.0


class ResubscribeQueue:
    """The lost topics of one identity; times are seconds of any one clock."""

    def __init__(self) -> None:
        self._due: dict[str, float] = {}
        self._pauses: dict[str, float] = {}

    def add(self, topic: str, began: float, now: float) -> None:
        """A connection for `topic`, made at `began`, has ended."""
        lasted = now - began > LONGEST_PAUSE
        pause = FIRST_PAUSE if lasted else self._pauses.get(topic, FIRST_PAUSE)
        self._due[topic] = now + pause
        self._pauses[topic] = min(2 * pause, LONGEST_PAUSE)

    def take_due(self, now: float, may_subscribe: Callable[[str], bool]) -> list[str]:
        """The topics to try again now; one without a right waits until there is one."""
        due = [topic for topic, at in self._due.items() if at <= now and may_subscribe(topic)]
        for topic in due:
            del self._due[topic]
        return due
