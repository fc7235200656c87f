"""How the service is, and a number that differs whenever what the console can show has changed.

It is asked every second, so it looks at little: the size of the log says whether the record
changed, the file's time whether the policy did.
"""

import contextlib
import hashlib
from collections.abc import Callable, Mapping
from pathlib import Path

from ca.encoding import Value
from rossec.authority.console.records import to_value
from rossec.authority.console.views import Status
from rossec.authority.home import fingerprint
from rossec.authority.keyservice.held_key import HeldKey
from rossec.authority.keyservice.work import AuthorityWork

INBOX = "inbox"  # in the authority's directory (`rossec.authority.requests`)


class StatusLook:
    """The operation that is asked every second.

    Args:
        work: of the authority.
        held: its key.
        has_master: whether the last call to the master succeeded.
        seen: whatever else differs when something to be shown has changed.
    """

    def __init__(
        self,
        work: AuthorityWork,
        held: HeldKey,
        has_master: Callable[[], bool],
        seen: Callable[[], tuple[object, ...]] = tuple,
    ) -> None:
        self._work = work
        self._held = held
        self._has_master = has_master
        self._seen = seen
        anchor = work.home().anchor()
        self._domain, self._fingerprint = anchor.domain, fingerprint(anchor)

    def handlers(self) -> Mapping[str, Callable[..., Value]]:
        """By the operation."""
        return {"status": self.status}

    def status(self) -> Value:
        """How it is now."""
        home, now = self._work.home(), self._work.now()
        with contextlib.closing(home.store()) as store, store.database.read_transaction():
            size, phones = store.log.head(now).size, len(store.passkeys.active())
        remaining, has_master = self._held.remaining(), self._has_master()
        files = (self._work.policy_path(), home.path / INBOX)
        number = _number(size, remaining is None, has_master, *map(_changed, files), *self._seen())
        return to_value(
            Status(
                self._domain, self._fingerprint, remaining is None, remaining, number, now,
                phones, has_master,
            )
        )  # fmt: skip


def _changed(path: Path) -> tuple[int, ...]:
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_mtime_ns, status.st_size, status.st_ino


def _number(*state: object) -> int:
    return int.from_bytes(hashlib.sha256(repr(state).encode()).digest()[:6])
