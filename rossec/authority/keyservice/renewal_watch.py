"""Identities of nodes that are due: fetched from the master, renewed, and brought back. A shell.

The service waits at the master for requests, so that a node has its new identity within seconds of
asking. While the key is locked it says so there, since nodes tell their users, and does not wait.
"""

import asyncio
import logging
import time
from collections.abc import Awaitable, Callable
from typing import Final, Protocol

from ca.encoding import Value
from ca.errors import HintedError
from rossec.authority.keyservice.work import AuthorityWork
from rossec.ros.names import SETTLE_RENEWALS, WATCH_RENEWALS
from rossec.ros.text import printable

WITHIN: Final = 40  # seconds for a call that waits at the master
SETTLE_WITHIN: Final = 15
LOCKED_PAUSE: Final = 10.0  # seconds until a locked service looks again
FIRST_PAUSE: Final = 1.0  # seconds after a failure, doubled up to
LONGEST_PAUSE: Final = 30.0
QUIET: Final = 60.0  # seconds out of reach until it is said: it may start after the service
_log = logging.getLogger("rossec.authority.service")

Renew = Callable[[list[bytes]], Awaitable[list[tuple[bytes, bytes, str]]]]


class CallsMaster(Protocol):
    """What calls the master (`FaceProcess`)."""

    async def call(self, method: str, arguments: list[Value], within: int) -> Value:
        """The value of its answer."""


class RenewalWatch:
    """Renews identities until it is cancelled.

    Args:
        face: calls the master.
        work: says whether the key is held.
        renew: answers requests, in the thread of the work.
    """

    def __init__(self, face: CallsMaster, work: AuthorityWork, renew: Renew) -> None:
        self._face = face
        self._work = work
        self._renew = renew
        self._looks_again = asyncio.Event()
        self._said = ""

    def wake(self) -> None:
        """Look again now: the key may have been unlocked."""
        self._looks_again.set()

    async def run(self) -> None:
        """Ask the master, and answer, again and again."""
        pause, reached = FIRST_PAUSE, time.monotonic()
        while True:
            self._looks_again.clear()
            locked, began = self._work.is_locked, time.monotonic()
            try:
                found = await self._look(locked=locked)
            except Exception as error:  # noqa: BLE001 - a crash must not end all renewals
                if not isinstance(error, HintedError | OSError):  # a TimeoutError is one
                    _log.exception("renewing identities failed")
                if time.monotonic() - reached >= QUIET:
                    cause = printable(error) or "no answer in time"
                    self._say(f"no identities are renewed: {cause}")
                await self._wait(pause)
                pause = min(2 * pause, LONGEST_PAUSE)
                continue
            pause, reached = FIRST_PAUSE, time.monotonic()
            if locked:
                await self._wait(LOCKED_PAUSE)
            elif found:
                self._said = ""
            elif time.monotonic() - began < FIRST_PAUSE:  # it should have waited
                await self._wait(FIRST_PAUSE)

    async def _look(self, *, locked: bool) -> int:
        """Ask the master once; returns how many requests were answered.

        Raises:
            HintedError, TimeoutError: it is out of reach, or of an older version.
        """
        answer = await self._face.call(WATCH_RENEWALS, [int(locked)], WITHIN)
        match answer:
            case {"renewals": list() as items, "waiting": int() as waiting}:
                requests = [item for item in items if isinstance(item, bytes)]
            case _:
                requests, waiting = [], 0
        if locked and waiting:
            self._say(
                f"{waiting} {'node waits' if waiting == 1 else 'nodes wait'} for a new identity,"
                " and the key is locked: rossec ca unlock --for 8h"
            )
        if not requests:
            return 0
        answers = await self._renew(requests)
        settled: list[Value] = [[digest, bundle, reason] for digest, bundle, reason in answers]
        if settled:
            await self._face.call(SETTLE_RENEWALS, [settled], SETTLE_WITHIN)
        return len(settled)

    async def _wait(self, seconds: float) -> None:
        try:
            async with asyncio.timeout(seconds):
                await self._looks_again.wait()
        except TimeoutError:
            return

    def _say(self, text: str) -> None:
        """Once, until something else is to be said."""
        if text != self._said:
            _log.warning("%s", text)
        self._said = text
