"""Maintenance: rights are enforced and lists confirmed, in rounds. A shell.

A round runs at every interval, and at once when a revocation list is delivered, for what was left
to enforce. An exception in one round does not end the rounds.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable
from typing import Final

from rossec.clock import Setbacks
from rossec.master.api.methods import DomainsChanged, RevocationsChanged
from rossec.master.server.effects import Effects, MasterState
from rossec.master.server.local_authority import SOURCE, LocalAuthority
from rossec.master.server.parameter_file import ParameterFile
from rossec.net.aio.tasks import TaskSet

_CLOCK_SET_BACK: Final = (
    "the host's clock went back: the master counts the seconds that have passed instead"
    " (set the clock right; if it is right now, restart the master)"
)

_SAVE_PAUSE: Final = 1.0  # seconds between two times that parameters are saved, however many
_log = logging.getLogger("rossec.master.upkeep")
_audit = logging.getLogger("rossec.audit")


class Maintenance:
    """Runs rounds of maintenance on `state`, from `start` to `close`.

    Args:
        interval: seconds between two rounds.
        check_own_identity: called with the time in each round.
        local_authority: may have signed newer lists.
    """

    def __init__(
        self,
        state: MasterState,
        effects: Effects,
        interval: float,
        check_own_identity: Callable[[int], None],
        local_authority: LocalAuthority,
    ) -> None:
        self._state = state
        self._effects = effects
        self._interval = interval
        self._check_own_identity = check_own_identity
        self._local_authority = local_authority
        self._setbacks = Setbacks()
        state.aliases.on_slot = effects.list_changed.set
        self._tasks = TaskSet()

    def start(self, keep_views: Callable[[frozenset[bytes]], None]) -> None:
        """Begin the rounds; `keep_views` discards what watchers saw, but those with these keys."""
        self._tasks.spawn(self._run(keep_views), name="rossec master maintenance")
        if self._state.parameter_file is not None:
            saving = self._save(self._state.parameter_file)
            self._tasks.spawn(saving, name="rossec master parameters")

    async def close(self) -> None:
        """End the rounds."""
        await self._tasks.close()

    async def _run(self, keep_views: Callable[[frozenset[bytes]], None]) -> None:
        while True:
            self._effects.list_changed.clear()
            try:
                await self._run_once()
                keep_views(self._connected_keys())
            except Exception:  # noqa: BLE001 - one failure must not end freshness and enforcement
                _log.exception("maintenance failed; it is tried again")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._pause()):
                    await self._effects.list_changed.wait()

    def _pause(self) -> float:
        """Seconds to the next round; neither the end of trust in a domain waits nor a slot."""
        now = self._state.now()
        moments = self._state.trust.domains.next_end(now), self._state.aliases.next_slot(now)
        waits = [moment - self._state.clock() for moment in moments if moment is not None]
        return min(self._interval, *waits) if waits else self._interval

    async def _run_once(self) -> None:
        if self._setbacks.any_new():
            _audit.warning(_CLOCK_SET_BACK)
        self._effects.close_revoked()
        await self._enforce()
        self._effects.send_revocations()
        self._prune()
        self._check_own_identity(self._state.now())
        if self._local_authority.has_newer_list(self._state.now()):
            self._effects.deliver(RevocationsChanged(SOURCE))
        if self._local_authority.has_newer_domains():
            self._effects.deliver(DomainsChanged(SOURCE))
        if self._state.deposit_file is not None:
            self._state.deposit_file.sync()

    async def _save(self, file: ParameterFile) -> None:
        """Save parameters; a disk takes its time, for which nothing that is revoked waits."""
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._interval):
                    await file.grown.wait()
            try:
                await file.save()
            except Exception:  # noqa: BLE001 - as above
                _log.exception("parameters were not saved; it is tried again")
            await asyncio.sleep(min(_SAVE_PAUSE, self._interval))  # also after a failure

    async def _enforce(self) -> None:
        """Remove what is no longer authorized; other calls are answered meanwhile."""
        for _ in self._effects.enforcement():
            self._state.notify()
            await asyncio.sleep(0)
        for updates in self._state.aliases.all_changes(self._state.now()):
            self._effects.send_publishers(updates)
            await asyncio.sleep(0)
        self._state.notify_all()  # rights also narrow what watchers see

    def _prune(self) -> None:
        self._effects.drop_deposits()
        nodes = frozenset(self._state.registry.nodes())
        self._effects.updates.prune(nodes)
        keys = self._connected_keys() | {node.thumbprint for node in nodes}
        self._state.trust.keep_only(keys, self._state.now())

    def _connected_keys(self) -> frozenset[bytes]:
        return frozenset(stream.peer.thumbprint for stream in self._state.streams)
