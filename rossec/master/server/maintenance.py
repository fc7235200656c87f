"""Maintenance: rights are enforced and lists confirmed, in rounds. A shell.

A round runs at every interval, and at once when a revocation list is delivered: the list is
enforced before that call is answered, except for what would take too long. An exception in one
round does not end the rounds.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterator, Sequence
from itertools import islice
from typing import Final

from ca.errors import HintedError
from rossec.clock import Setbacks
from rossec.master.api.dispatch import MasterApi
from rossec.master.api.methods import MasterEvent
from rossec.master.rights.enforce import enforce, steps
from rossec.master.server.effects import MasterState
from rossec.net.aio.tasks import TaskSet
from rossec.ros.text import printable

_CLOCK_SET_BACK: Final = (
    "the host's clock went back: the master counts the seconds that have passed instead"
    " (set the clock right; if it is right now, restart the master)"
)
STEPS_AT_ONCE: Final = 1024  # enforcement steps before the next call is answered

_log = logging.getLogger("rossec.master.upkeep")
_audit = logging.getLogger("rossec.audit")


class Maintenance:
    """Runs rounds of maintenance on `state`, from `start` to `close`.

    Args:
        deliver: performs the effect of an event (`Effects.deliver`).
        interval: seconds between two rounds.
        checks: called with the time in each round.
    """

    def __init__(
        self,
        state: MasterState,
        deliver: Callable[[MasterEvent], None],
        interval: float,
        checks: Sequence[Callable[[int], None]],
    ) -> None:
        self._state = state
        self._deliver = deliver
        self._interval = interval
        self._checks = checks
        self._api: MasterApi | None = None
        self._setbacks = Setbacks()
        self._tasks = TaskSet()
        self._changed = asyncio.Event()  # revocations: the next round must not wait

    def start(self, api: MasterApi) -> None:
        """Begin the rounds; `api` stores state that is to be pruned."""
        self._api = api
        self._tasks.spawn(self._run(), name="rossec master maintenance")

    async def close(self) -> None:
        """End the rounds."""
        await self._tasks.close()

    def revocations_changed(self) -> None:
        """Enforce a new list: as much as possible now, the rest soon."""
        for _ in islice(self._enforcement(), STEPS_AT_ONCE):
            pass
        self._close_revoked()  # also their pending updates
        self._drop_deposits()
        self._send_revocations()
        self._changed.set()

    async def _run(self) -> None:
        while True:
            self._changed.clear()
            try:
                await self._run_once()
            except Exception:  # noqa: BLE001 - one failure must not end freshness and enforcement
                _log.exception("maintenance failed; it is tried again")
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(self._interval):
                    await self._changed.wait()

    async def _run_once(self) -> None:
        if self._setbacks.any_new():
            _audit.warning(_CLOCK_SET_BACK)
        self._close_revoked()
        await self._enforce()
        self._send_revocations()
        self._prune()
        for check in self._checks:
            check(self._state.now())
        for file in (self._state.parameter_file, self._state.deposit_file):
            if file is not None:
                file.sync()

    async def _enforce(self) -> None:
        """Remove what is no longer authorized; other calls are answered meanwhile."""
        for _ in self._enforcement():
            self._state.graph_changes.notify(self._state.registry.version)
            await asyncio.sleep(0)
        self._state.graph_changes.notify()  # rights also narrow what watchers see

    def _enforcement(self) -> Iterator[None]:
        """Enforce rights on all registrations, some in each step."""
        if self._api is not None:
            for step in steps(self._state.registry):
                state = self._state
                for event in enforce(state.registry, state.trust, step, state.now()):
                    self._deliver(event)
                yield

    def _close_revoked(self) -> None:
        """Close the connections of revoked identities, and drop their updates."""
        now = self._state.now()
        for stream in tuple(self._state.streams):
            try:
                self._state.trust.caller(stream.peer, now)
            except HintedError as error:
                _audit.warning("%s is disconnected: %s", stream.peer.name, printable(error))
                self._state.streams.discard(stream)  # its handler ends in a later iteration
                stream.abort(str(error))
        for node in self._state.updates.nodes:
            if self._state.trust.caller_of(node, now) is None:
                self._state.updates.drop(node)

    def _drop_deposits(self) -> None:
        file = self._state.deposit_file
        if file is not None:
            file.deposits.drop_ended(self._state.now(), self._state.trust.revoked())

    def _prune(self) -> None:
        self._drop_deposits()
        nodes = frozenset(self._state.registry.nodes())
        self._state.updates.prune(nodes)
        registered = {node.thumbprint for node in nodes}
        connected = {stream.peer.thumbprint for stream in self._state.streams}
        self._state.trust.keep_only(frozenset(registered | connected), self._state.now())
        if self._api is not None:
            self._api.watch_calls.keep_only(frozenset(connected))

    def _send_revocations(self) -> None:
        """Send every node a timestamp of the list, and the list to nodes that do not hold it."""
        now, key = self._state.now(), ("rossec.revocationUpdate", "")
        for node in self._state.registry.nodes():
            revocations, timestamp = self._state.trust.revocations_for(node, now)
            if timestamp and self._state.trust.caller_of(node, now) is not None:
                self._state.updates.post(node, key, self._state.name, revocations, timestamp)
