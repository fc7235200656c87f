"""Revocation lists of an authority on the master's host: read from its directory.

A list that could not be delivered, as the master was not running or not reachable, would otherwise
wait for a person, while the master keeps confirming the old one. The directory is read in each
maintenance round; an invalid list is logged, and the list in force stays.
"""

import logging
from collections.abc import Callable
from typing import Final, TypeAlias

from ca.errors import HintedError
from ca.revocation.tree import is_tree
from rossec.master.rights.statements import TrustState
from rossec.ros.text import printable

SOURCE: Final = "the authority on this host"

_log = logging.getLogger("rossec.master.nearby")

FindRevocations: TypeAlias = Callable[[], tuple[bytes, bytes] | None]
"""Returns the newest signed list or tree, and the entries of a tree; None: unchanged."""


def no_authority() -> None:
    """No authority is on this host."""


class LocalAuthority:
    """Reads the lists of a local authority.

    Args:
        find: reads the directory of the authority. Raises `HintedError` or `OSError`.
        trust: accepts the lists.
    """

    def __init__(self, find: FindRevocations, trust: TrustState) -> None:
        self._find = find
        self._trust = trust
        self._last_warning: str | None = None

    def has_newer_list(self, now: int) -> bool:
        """Accept the list of the authority, if it is newer; returns whether it was."""
        try:
            found = self._find()
            newer = found is not None and self._accept(*found, now)
        except (HintedError, OSError) as error:
            self._warn_once(printable(error))
            return False
        self._last_warning = None
        return newer

    def _warn_once(self, reason: str) -> None:
        """Log each reason once, although every round checks again."""
        if reason != self._last_warning:
            _log.warning("the list of %s is not accepted: %s", SOURCE, reason)
        self._last_warning = reason

    def _accept(self, data: bytes, entries: bytes, now: int) -> bool:
        if is_tree(data):
            return self._trust.update_tree(data, entries, now)
        return self._trust.update(data, now)
