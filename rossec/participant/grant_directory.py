"""The grants in a node's directory: each is loaded once, an invalid one is logged once.

Grants may arrive while the node runs; they are checked by `access`.
"""

import contextlib
import logging
from pathlib import Path
from typing import Final

from ca.errors import HintedError
from grants.errors import GrantError
from grants.token import peek
from rossec.home import NodeHome
from rossec.participant.access_interfaces import HeldGrants

KEPT: Final = 30 * 86400  # seconds after its end that a file stays

_log = logging.getLogger("rossec.node")


class GrantDirectory:
    """Moves the grants of a directory into a node's `Access`."""

    def __init__(self, home: NodeHome, access: HeldGrants) -> None:
        self._home = home
        self._access = access
        self._seen: set[bytes] = set()
        self._errors: dict[Path, str] = {}

    def take_new(self) -> list[bytes]:
        """Hold the grants that are new in the directory; returns them."""
        paths = self._home.grant_files()
        self._errors = {path: text for path, text in self._errors.items() if path in paths}
        found = ((path, self._read(path)) for path in paths)
        return [data for path, data in found if data is not None and self._hold(path, data)]

    def hold(self, data: bytes) -> bool:
        """Hold a verified grant that was delivered; whether it is new."""
        return self._hold(self._home.path, data)

    def save(self, grant_id: bytes, data: bytes) -> None:
        """Store a grant that is held; a full disk is logged. For any thread."""
        try:
            self._home.add_grant(grant_id, data)
        except (OSError, HintedError) as error:  # the master has it after a restart, too
            _log.warning("a delivered grant is used, but not saved: %s", error)

    def drop_ended(self, now: int) -> None:
        """Delete the files of grants that ended long ago; only while the master confirms `now`."""
        for path in self._home.grant_files():
            data = self._read(path)
            if data is not None and self._has_ended(path, data, now):
                with contextlib.suppress(OSError):
                    path.unlink()

    def _read(self, path: Path) -> bytes | None:
        try:
            data = self._home.read_grant(path)
        except (OSError, HintedError) as error:
            self._warn_once(path, f"cannot be read: {error}")
            return None
        self._errors.pop(path, None)
        return data

    def _hold(self, path: Path, data: bytes) -> bool:
        """Whether it is a valid grant, and new."""
        if data in self._seen:
            return False
        self._seen.add(data)
        try:
            self._access.hold(data)
        except HintedError as error:
            _log.warning("%s is not a valid grant and is ignored: %s", path, error)
            return False
        return True

    def _warn_once(self, path: Path, error: str) -> None:
        """Log an error once for each cause."""
        if self._errors.get(path) != error:
            self._errors[path] = error
            _log.warning("%s %s", path, error)

    def _has_ended(self, path: Path, data: bytes, now: int) -> bool:
        """Whether a file that `NodeHome.add_grant` wrote is of no use any more."""
        try:
            grant = peek(data)
        except GrantError:
            return False
        return path == self._home.grant_file(grant.id) and now >= grant.cap + KEPT
