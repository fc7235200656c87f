"""Saving the newest lists, of revocations and of domains, even if the disk is full at first.

A list is made durable before it takes effect; but a revocation must not wait for room on a disk
that the revoked node may have filled. So a list that cannot be saved is in force all the same; that
is logged, and every maintenance round tries to save it again. A master that is restarted before has
the older list: nodes that hold the newer one refuse its timestamps, and authorize nothing.
"""

import logging
from collections.abc import Callable

from ca.errors import HintedError
from rossec.errors import NotWritten
from rossec.home import NodeHome

_log = logging.getLogger("rossec.master.keeping")


Write = Callable[[bytes], None]


class ListFile:
    """Saves lists and the entries of trees in `home`, later if not possible now."""

    def __init__(self, home: NodeHome) -> None:
        self._home = home
        # By what is written, in the order in which that must be.
        self._unwritten: dict[object, tuple[Write, bytes]] = {}
        self._failing = False

    def save(self, data: bytes) -> None:
        """Save a signed list or tree; durable on return, or the failure is logged."""
        self.save_by("revocations", self._home.save_revocations, data)

    def save_entries(self, data: bytes) -> None:
        """Save the entries of a tree, which is saved after them."""
        self.save_by("entries", self._home.save_entries, data)

    def save_by(self, what: object, write: Write, data: bytes) -> None:
        """Save the newest of `what`; durable on return, or the failure is logged."""
        self._unwritten.pop(what, None)
        self._unwritten[what] = write, data
        self.retry()

    def retry(self) -> None:
        """Write what is not written yet; called in each maintenance round."""
        try:
            for what, (write, data) in tuple(self._unwritten.items()):
                write(data)
                del self._unwritten[what]
        except (NotWritten, OSError) as error:
            self._log_failure(error)
            return
        if self._failing:
            self._failing = False
            _log.warning("the newest lists are saved now")

    def _log_failure(self, error: Exception) -> None:
        if not self._failing:
            hint = f" ({error.hint})" if isinstance(error, HintedError) else ""
            _log.error("a list is in force, but not saved: %s%s", error, hint)
        self._failing = True
