"""A site that is reached by a relay of this site: the doors of its master, nodes and services.

A shell: what doors there are is `rossec.master.state.doors`'s, how facts become doors is
`door_facts`'s. The relay is another process, so every door is waited for, and not long.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Collection
from typing import Any, Final

from rossec.errors import RelayRefused
from rossec.federation.answers import SiteChange
from rossec.federation.door_facts import DoorFacts
from rossec.federation.settings import SiteSettings
from rossec.master.state.doors import MASTER, MAX_DOORS, Doors, Target

DOOR_WAIT: Final = 5.0  # seconds for the master's door: a relay that polls opens it at once
NODES_WAIT: Final = 1.0  # seconds for those of new nodes; they are shown without others after it
NO_CHANGE: Final = SiteChange(frozenset(), frozenset(), False, b"", b"")
_log = logging.getLogger("rossec.federation")


class SiteDoors:
    """The doors of one site.

    Args:
        on_door: called when the master's door was opened.
    """

    def __init__(self, doors: Doors, settings: SiteSettings, on_door: Callable[[], None]) -> None:
        self._doors = doors
        self._settings = settings
        self._on_door = on_door
        self._master = Target(settings.via, MASTER, settings.master)
        self._facts = DoorFacts(settings.via, doors.door)
        self._had_door = False
        self._missing = 0
        self.changed: Final = asyncio.Event()
        doors.listen(settings.label, self._note)

    async def address(self) -> tuple[str, int]:
        """The door of the site's master.

        Raises:
            RelayRefused: there is none.
        """
        self._want(self._facts.targets)
        await self._wait([self._master], DOOR_WAIT)
        door = self._doors.door(self._master)
        if door is not None:
            return door
        if self._doors.way(self._settings.via) is None:
            raise RelayRefused(
                f"no relay of this site knows a peer {self._settings.via}",
                f"is `rossec relay` running, and was this done: rossec relay add"
                f" {self._settings.via} FILE",
            )
        raise RelayRefused(
            f"the relay opens no door for {self._settings.master} of {self._settings.via}",
            "rossec relay status",
        )

    async def take(self, change: SiteChange) -> SiteChange:
        """A complete answer of the site, with doors for its addresses.

        Raises:
            ImportRefused: a malformed fact, or too many.
        """
        before = self._facts.targets
        for _ in self._facts.take(change):
            await asyncio.sleep(0)
        targets = self._facts.targets
        self._want(targets)
        await self._wait(targets - before, NODES_WAIT)
        return self.refreshed(change)

    def refreshed(self, change: SiteChange = NO_CHANGE) -> SiteChange:
        """`change`, and what is other with the doors of now."""
        self.changed.clear()
        return self._facts.shown(change)

    def drop(self) -> None:
        """The facts of the site are dropped; it is still followed."""
        self._facts.forget()
        self._want(())

    def close(self) -> None:
        """The site is followed no longer."""
        self._doors.forget(self._settings.label)

    def status(self) -> dict[str, Any]:
        """The way there, for people and programs; empty: no relay knows the peer."""
        found = self._doors.way(self._settings.via)
        if found is None:
            return {}
        return {"relay": found[0], **found[1]._asdict()}

    def _want(self, targets: Collection[Target]) -> None:
        missing = self._doors.want(self._settings.label, {self._master, *targets})
        if missing and not self._missing:
            _log.warning(
                "site %s: %d nodes and services have no address here: a site has half of %d doors",
                self._settings.label, missing, MAX_DOORS,
            )  # fmt: skip
        self._missing = missing

    async def _wait(self, targets: Collection[Target], longest: float) -> None:
        """Return when all have a door, or after `longest` seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                while any(self._doors.door(target) is None for target in targets):
                    self.changed.clear()
                    await self.changed.wait()
        self.changed.set()  # it was not looked at what else has changed

    def _note(self) -> None:
        self.changed.set()
        has_door = self._doors.door(self._master) is not None
        if has_door and not self._had_door:
            self._on_door()
        self._had_door = has_door
