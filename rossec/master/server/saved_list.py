"""The newest revocation list on the master's disk, also when the disk does not take it.

A list is made durable before it takes effect; but what revokes somebody must not wait for room on a
disk that he may have filled himself. So a list that cannot be kept is in force all the same, which
is said, and it is written at the first beat at which there is room. A master that ends before that
has the older list: nodes that know the newer one refuse its confirmations, and allow nothing.
"""

import logging
from collections.abc import Callable

from ca.errors import HintedError
from rossec.errors import NotWritten
from rossec.home import NodeHome

_log = logging.getLogger("rossec.master.keeping")


class ListFile:
    """Writes lists and the entries of trees into `home`, sooner or later."""

    def __init__(self, home: NodeHome) -> None:
        self._home = home
        self._unwritten: dict[
            Callable[[bytes], None], bytes
        ] = {}  # in the order in which it is needed
        self._failing = False

    def save(self, data: bytes) -> None:
        """Keep a signed list or tree; durable on return, or said not to be."""
        self._save(self._home.save_revocations, data)

    def save_entries(self, data: bytes) -> None:
        """Keep the entries of a tree, which is saved after them."""
        self._save(self._home.save_entries, data)

    def retry(self) -> None:
        """Write what is not written; call it now and then."""
        try:
            for write in tuple(self._unwritten):
                write(self._unwritten[write])
                del self._unwritten[write]
        except (NotWritten, OSError) as error:
            self._log_failure(error)
            return
        if self._failing:
            self._failing = False
            _log.warning("the revocation list is kept now")

    def _save(self, write: Callable[[bytes], None], data: bytes) -> None:
        self._unwritten.pop(write, None)
        self._unwritten[write] = data
        self.retry()

    def _log_failure(self, error: Exception) -> None:
        if not self._failing:
            hint = f" ({error.hint})" if isinstance(error, HintedError) else ""
            _log.error("the revocation list is in force, but not kept: %s%s", error, hint)
        self._failing = True
