"""Messages as their bytes arrive; one that was begun must be finished. Pure.

Units need not end where messages do: a sidecar passes on what its program writes. So what holds for
a unit (`progress`) is asked of a message as well.
"""

from typing import Final

from rossec.progress import STEP, Progress
from rossec.ros.header import FrameReader

PATIENCE: Final = float(STEP)
"""How long to wait for more of a message before `Framing.check_progress`, in seconds."""


class Framing:
    """Cuts what arrives into messages, and says when one takes too long.

    `now` is in seconds, of any clock.
    """

    def __init__(self, reader: FrameReader) -> None:
        self._reader = reader
        self._progress = Progress()

    @property
    def incomplete(self) -> bool:
        """Whether a message has been begun."""
        return self._reader.pending > 0

    def feed(self, data: bytes | memoryview, now: int) -> list[bytes]:
        """All messages that `data` completes.

        Raises:
            FrameRefused: one is longer than allowed.
            LimitExceeded: one takes too long.
        """
        messages = self._reader.feed(data)
        if messages:
            self._progress.done()
        self.check_progress(now)
        return messages

    def feed_one(self, data: bytes, now: int) -> bytes | None:
        """As `FrameReader.feed_one`; raises as `feed`."""
        message = self._reader.feed_one(data)
        if message is not None:
            self._progress.done()
        self.check_progress(now)
        return message

    def check_progress(self, now: int) -> None:
        """Ask whether a message that was begun gets on.

        Raises:
            LimitExceeded: it does not.
        """
        if self._reader.pending > 0:
            self._progress.check(now, self._reader.pending)
