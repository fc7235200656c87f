"""Which things a border router serves now: those of its statements that are valid and not revoked.

What its directory holds is read again when that changes, and once a second right after. A thing is
served by a statement that names this router's key (`saved_things` checks that), in time, and known
not to be revoked; so is its credential, which the authority may revoke by itself. What is not known
counts as no.
"""

import logging
from collections.abc import Callable
from typing import Final, NamedTuple

from ca.errors import CAError, HintedError
from ca.revocation.state import Revocations
from ca.things.credentials import ThingKey
from ca.things.statement import ThingStatement
from rossec.saved_things import ThingFiles

_NANOSECONDS: Final = 10**9  # of a second
_log = logging.getLogger("rossec.border")


class ServedThing(NamedTuple):
    """A thing: what the authority says of it, and its secret (empty: it has a key)."""

    statement: ThingStatement
    secret: bytes


class Roster:
    """The things of one border router.

    Args:
        files: its statements and secrets.
        revocations: of the authority.
        clock: seconds since the epoch.
    """

    def __init__(
        self, files: ThingFiles, revocations: Revocations, clock: Callable[[], int]
    ) -> None:
        self._files = files
        self._revocations: Final = revocations
        self._clock = clock
        self._things: dict[str, ServedThing] = {}
        self._keys: dict[bytes, list[str]] = {}
        self._secrets: dict[bytes, list[str]] = {}
        self._refused: dict[str, str] = {}
        self._read_at, self._read_second, self._settled = -1, 0, False

    def __len__(self) -> int:
        return len(self._things)

    @property
    def names(self) -> list[str]:
        """Of all things that have a statement here."""
        return sorted(self._things)

    def statement(self, name: str) -> ThingStatement | None:
        """The statement about a thing."""
        found = self._things.get(name)
        return None if found is None else found.statement

    def reload(self) -> bool:
        """Read the directory again if it has changed; returns whether it has."""
        try:
            changed = self._files.path.stat().st_mtime_ns
        except OSError:
            changed = 0
        now = self._clock()
        if changed == self._read_at and (self._settled or now == self._read_second):
            return False
        # A file system's clock has steps: what is written right after is not seen by the time.
        self._settled = changed // _NANOSECONDS < now - 1
        self._read_at, self._read_second = changed, now
        loaded = self._files.load()
        refused = {str(path): str(error) for path, error in loaded.refused.items()}
        things: dict[str, ServedThing] = {}
        for statement in sorted(loaded.statements.values(), key=lambda each: each.not_before):
            try:
                things[statement.name] = ServedThing(statement, self._secret(statement))
            except (HintedError, OSError) as error:
                refused[statement.name] = str(error)
        self._log_refused(refused)
        self._things = things
        self._keys, self._secrets = {}, {}
        for name, (statement, secret) in things.items():
            kids = self._secrets if secret else self._keys
            kids.setdefault(statement.credential.kid, []).append(name)
        return True

    def by_key(self, kid: bytes) -> tuple[str, ThingKey] | None:
        """The thing with a key that has this kid, if it is served."""
        self.reload()
        found = self._usable(self._keys, kid)
        if found is None or not isinstance(found.statement.credential, ThingKey):
            return None
        return found.statement.name, found.statement.credential

    def by_secret(self, kid: bytes) -> tuple[str, bytes] | None:
        """The thing with a secret that has this kid, if it is served."""
        self.reload()
        found = self._usable(self._secrets, kid)
        return None if found is None else (found.statement.name, found.secret)

    def is_served(self, name: str, credential: bytes) -> bool:
        """Whether the thing that began with this credential may go on.

        A thing that is there stays while it is not known whether something is revoked: its
        connections end by their own rules.
        """
        found = self._things.get(name)
        if found is None or found.statement.credential.thumbprint != credential:
            return False
        revoked = self._revocations.entries
        ends = found.statement.expires <= self._clock()
        return not ends and revoked.isdisjoint((found.statement.id, credential))

    def entries(self) -> list[bytes]:
        """What may be revoked of the things here: statements and credentials."""
        things = self._things.values()
        return [
            entry
            for statement, _ in things
            for entry in (statement.id, statement.credential.thumbprint)
        ]

    def _usable(self, kids: dict[bytes, list[str]], kid: bytes) -> ServedThing | None:
        """The thing with this kid that may be served: one that was renamed has two statements."""
        for name in reversed(kids.get(kid, [])):
            found = self._things[name]
            if self._is_usable(found):
                return found
        return None

    def _is_usable(self, found: ServedThing) -> bool:
        now = self._clock()
        try:
            found.statement.check_time(now)
            self._revocations.check(found.statement.id, now)
            self._revocations.check(found.statement.credential.thumbprint, now)
        except CAError as error:
            _log.info("%s is not served: %s", found.statement.name, error)
            return False
        return True

    def _secret(self, statement: ThingStatement) -> bytes:
        if isinstance(statement.credential, ThingKey):
            return b""
        return self._files.secret_of(statement)

    def _log_refused(self, refused: dict[str, str]) -> None:
        for what, reason in refused.items():
            if self._refused.get(what) != reason:
                _log.warning("%s: %s", what, reason)
        self._refused = refused
