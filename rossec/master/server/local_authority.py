"""The list of an authority that lives on the master's host: taken without anybody carrying it.

A list that could not be delivered (the master was stopped, or not there) would otherwise wait for a
person, while the master goes on confirming the old one. It is looked for at every beat; whatever is
wrong with it is said, and the list in force stays.
"""

import logging
from collections.abc import Callable
from typing import Final, TypeAlias

from ca.errors import HintedError
from ca.revocation.tree import is_tree
from rossec.master.rights.interfaces import Statements
from rossec.ros.text import printable

SOURCE: Final = "the authority on this host"

_log = logging.getLogger("rossec.master.nearby")

FindRevocations: TypeAlias = Callable[[], tuple[bytes, bytes] | None]
"""The newest signed list or tree and the entries of a tree; None: it is what it was before."""


def no_authority() -> None:
    """There is no authority on this host."""


class LocalAuthority:
    """Looks for news.

    Args:
        find: looks where the authority keeps what it signed. Raises `HintedError` or `OSError`.
        statements: takes them.
        on_changed: called when a newer list is in force.
    """

    def __init__(
        self, find: FindRevocations, statements: Statements, on_changed: Callable[[], None]
    ) -> None:
        self._find = find
        self._statements = statements
        self._on_changed = on_changed
        self._last_warning: str | None = None

    def check(self, now: int) -> None:
        """Take what is there, if it is newer."""
        try:
            found = self._find()
            newer = found is not None and self._take(*found, now)
        except (HintedError, OSError) as error:
            self._warn_once(printable(error))
        else:
            self._last_warning = None
            if newer:
                self._on_changed()

    def _warn_once(self, why: str) -> None:
        """Once for each reason: it is looked for again at every beat."""
        if why != self._last_warning:
            _log.warning("the list of %s is not taken: %s", SOURCE, why)
        self._last_warning = why

    def _take(self, data: bytes, entries: bytes, now: int) -> bool:
        if is_tree(data):
            return self._statements.update_tree(data, entries, now)
        return self._statements.update(data, now)
