"""Messages from a byte stream; an incomplete one must make progress. Pure.

Units need not end where messages do: a sidecar forwards what its program writes. So the rule for a
unit (`progress`) applies to a message as well.
"""

from typing import Final

from rossec.progress import STEP, Progress
from rossec.ros.header import FrameReader

PATIENCE: Final = float(STEP)
"""How long to wait for more of a message before `Framing.check_progress`, in seconds."""


class Framing:
    """Splits a byte stream into messages, and refuses one that takes too long.

    `now` is in seconds, of any clock.
    """

    def __init__(self, reader: FrameReader) -> None:
        self._reader = reader
        self._progress = Progress()

    @property
    def incomplete(self) -> bool:
        """Whether part of a message has arrived."""
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
        """Check that an incomplete message grows.

        Raises:
            LimitExceeded: it does not.
        """
        if self._reader.pending > 0:
            self._progress.check(now, self._reader.pending)
