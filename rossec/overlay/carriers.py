"""What a link needs of whatever carries its frames; `zenoh_carrier.Carrier` is the real one."""

from collections.abc import Callable
from typing import Protocol


class MailboxReader(Protocol):
    """A mailbox that is read."""

    def close(self) -> None:
        """Read it no more."""
        ...


class FrameCarrier(Protocol):
    """Carries frames to mailboxes: any of them may be lost, come twice, or late."""

    @property
    def heard_at(self) -> float:
        """When the last message arrived, whichever it was, on the loop's clock."""
        ...

    def put(self, key: str, data: bytes) -> None:
        """Send a frame to a mailbox; never raises for one that is lost."""
        ...

    def subscribe(self, key: str, callback: Callable[[bytes], None]) -> MailboxReader:
        """Call back on the loop with each frame that arrives in a mailbox."""
        ...

    def reopen(self) -> None:
        """Begin anew with the routers: nothing arrives any more."""
        ...
