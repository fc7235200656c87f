"""The grants in a node's directory: each is taken once, a bad one is told once.

A shell. Grants may arrive while the node runs; nothing here judges them, `access` does.
"""

import logging

from ca.errors import HintedError
from rossec.home import NodeHome
from rossec.node.access import Access

_log = logging.getLogger("rossec.node")


class Shelf:
    """Moves the grants of a directory into a node's `Access`."""

    def __init__(self, home: NodeHome, access: Access) -> None:
        self._home = home
        self._access = access
        self._seen: set[bytes] = set()
        self._trouble = ""

    def take_new(self) -> list[bytes]:
        """Hold the grants that were not there before; returns them."""
        taken = [data for data in self._read() if data not in self._seen]
        self._seen.update(taken)
        return [data for data in taken if self._hold(data)]

    def _read(self) -> list[bytes]:
        try:
            grants = self._home.grants()
        except (OSError, HintedError) as error:
            self._complain(str(error))
            return []
        self._trouble = ""
        return grants

    def _hold(self, data: bytes) -> bool:
        try:
            self._access.hold(data)
        except HintedError as error:
            _log.warning("a file in %s/grants is no grant: %s", self._home.path, error)
            return False
        return True

    def _complain(self, trouble: str) -> None:
        if trouble != self._trouble:
            self._trouble = trouble
            _log.warning("%s: cannot read the grants: %s", self._home.name, trouble)
