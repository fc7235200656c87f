"""The lists of an authority on the master's host: read from its directory.

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

FindDomains: TypeAlias = Callable[[], bytes]
"""Returns the newest signed list of domains; empty: unchanged, or there is none."""


def no_authority() -> None:
    """No authority is on this host."""


def no_domains() -> bytes:
    """No authority on this host has signed a list of domains."""
    return b""


class LocalAuthority:
    """Reads the lists of a local authority.

    Args:
        find: reads the directory of the authority. Raises `HintedError` or `OSError`.
        trust: accepts the lists.
        find_domains: likewise.
    """

    def __init__(
        self, find: FindRevocations, trust: TrustState, find_domains: FindDomains = no_domains
    ) -> None:
        self._find = find
        self._trust = trust
        self._find_domains = find_domains
        self._last_warnings: dict[str, str] = {}  # by what was looked for

    def has_newer_list(self, now: int) -> bool:
        """Accept the list of the authority, if it is newer; returns whether it was."""
        return self._take("list", lambda: self._newest(now))

    def has_newer_domains(self) -> bool:
        """As `has_newer_list`, for the list of domains."""
        return self._take("list of domains", self._newest_domains)

    def _take(self, what: str, accept: Callable[[], bool]) -> bool:
        """What `accept` returns; a reason to refuse is logged once, although each round checks."""
        try:
            newer = accept()
        except (HintedError, OSError) as error:
            reason = printable(error)
            if reason != self._last_warnings.get(what):
                _log.warning("the %s of %s is not accepted: %s", what, SOURCE, reason)
            self._last_warnings[what] = reason
            return False
        self._last_warnings.pop(what, None)
        return newer

    def _newest(self, now: int) -> bool:
        found = self._find()
        return found is not None and self._accept(*found, now)

    def _newest_domains(self) -> bool:
        data = self._find_domains()
        return data != b"" and self._trust.update_domains(data)

    def _accept(self, data: bytes, entries: bytes, now: int) -> bool:
        if is_tree(data):
            return self._trust.update_tree(data, entries, now)
        return self._trust.update(data, now)
