"""All sites that a master follows: from its configuration, from its file, and announced. A shell.

The file is read again when it has changed, so `rossec federation add` takes effect in a running
master. A label that the configuration has prevails over the file's, and both over an announced one.
"""

import asyncio
import contextlib
import logging
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.federation.announced import AnnouncedMasters
from rossec.federation.follower import FollowedSite
from rossec.federation.own import OwnMaster
from rossec.federation.settings import SiteSettings, checked_sites
from rossec.master.state.addresses import is_connectable
from rossec.net.aio.tasks import TaskSet
from rossec.ros.text import printable

_TICK: Final = 1.0
_ANNOUNCED: Final = "announced"
_log = logging.getLogger("rossec.federation")
_audit = logging.getLogger("rossec.audit")

ReadSites = Callable[[], Iterable[SiteSettings]]
"""The sites of one origin as of now; raises ConfigurationError."""


class Mesh:
    """Follows every site of its sources.

    Args:
        own: the master that follows.
        sources: by what they are called, the one that prevails first.
        announced: the masters heard on the local links; None: they are not followed.
    """

    def __init__(
        self,
        own: OwnMaster,
        sources: Mapping[str, ReadSites],
        announced: AnnouncedMasters | None = None,
    ) -> None:
        self._own = own
        self._announced = announced
        heard: dict[str, ReadSites] = {} if announced is None else {_ANNOUNCED: announced.sites}
        self._sources = {**sources, **heard}
        self._last: dict[str, tuple[SiteSettings, ...]] = {}
        self._warned: dict[str, str] = {}
        self._followers: dict[str, tuple[FollowedSite, asyncio.Task[Any]]] = {}
        self._tasks = TaskSet()
        own.state.trust.domains.own_sites = self._own_labels
        own.state.doors.masters = self._direct_masters

    async def run(self) -> None:
        """Follow until cancelled."""
        self._own.effects.on_new_lists.append(self._send_lists)
        listening = (
            contextlib.nullcontext() if self._announced is None else self._announced.listening()
        )
        try:
            async with listening:
                while True:
                    try:
                        self._step()
                    except Exception:  # noqa: BLE001 - one failure must not end that sites are followed
                        _log.exception("sites: a round failed; it is tried again")
                    await asyncio.sleep(_TICK)
        finally:
            self._own.effects.on_new_lists.remove(self._send_lists)
            await self._tasks.close()

    def status(self) -> dict[str, Any]:
        """Every site, and what is wrong with the settings."""
        rows = [
            {**follower.status(), "source": self._source_of(label)}
            for label, (follower, _) in sorted(self._followers.items())
        ]
        return {"sites": rows, "problems": dict(self._warned)}

    def _step(self) -> None:
        self._update()
        returned = set() if self._announced is None else self._announced.take_returned()
        for relay in self._own.state.doors.expire(self._own.state.now()):
            _audit.warning("relay %s is silent", relay)
        for follower, _ in self._followers.values():
            follower.tick()
            if not follower.settings.domain and follower.settings.master in returned:
                follower.wake()

    def _update(self) -> None:
        wanted = self._wanted()
        for label, (follower, task) in tuple(self._followers.items()):
            if wanted.get(label) != follower.settings:
                task.cancel()
                del self._followers[label]
                follower.remove()
                _audit.info("site %s is followed no longer", label)
        for label in sorted(wanted.keys() - self._followers.keys()):
            follower = FollowedSite(wanted[label], self._own)
            task = self._tasks.spawn(follower.run(), f"site {label}")
            self._followers[label] = follower, task

    def _wanted(self) -> dict[str, SiteSettings]:
        """The sites of all sources; one that contradicts an earlier one is left out."""
        found: dict[str, SiteSettings] = {}
        before, self._warned = self._warned, {}
        for name, source in self._sources.items():
            try:
                self._last[name] = tuple(source())
            except (ConfigurationError, OSError) as error:  # the last that was read stays
                self._warned[name] = _text(error)
            for each in self._last.get(name, ()):
                if name != _ANNOUNCED or not _has_master(found, each):
                    self._add(found, each)
        for where, text in self._warned.items():
            if before.get(where) != text:
                _log.warning("%s: %s", where, text)
        return found

    def _add(self, found: dict[str, SiteSettings], each: SiteSettings) -> None:
        where = f"site {each.label}"
        try:
            self._check_label(each)
            checked_sites([*found.values(), each])
        except ConfigurationError as error:
            self._warned[where] = _text(error)
            return
        found[each.label] = each

    def _check_label(self, each: SiteSettings) -> None:
        anchors = self._own.state.trust.domains.anchors
        if each.domain and anchors.listed(each.domain) is None:
            raise ConfigurationError(
                f"{each.domain} is not a domain that is trusted here", "rossec domain list"
            )
        if not each.domain and anchors.listed(each.label) is not None:
            raise ConfigurationError(
                f"{each.label} is the label of a foreign domain",
                f"follow it with --domain {each.label}, or choose another label",
            )
        if not each.domain and each.master == self._own.name:
            raise ConfigurationError(f"{each.master} is this master itself", "follow another one")

    def _own_labels(self) -> list[str]:
        """The labels of other masters of the own domain, whose nodes have aliases here."""
        found = [follower.settings for follower, _ in self._followers.values()]
        return [each.label for each in found if not each.domain]

    def _direct_masters(self) -> dict[str, str]:
        """The masters of the own domain that a relay of this site can reach itself."""
        found = [follower.settings for follower, _ in self._followers.values()]
        return {
            each.master: each.uri
            for each in found
            if not each.domain and is_connectable(each.uri, "http")
        }

    def _source_of(self, label: str) -> str:
        return next(
            (name for name, sites in self._last.items() if any(s.label == label for s in sites)), ""
        )

    def _send_lists(self) -> None:
        for follower, _ in self._followers.values():
            self._tasks.spawn(follower.send_lists(), f"lists for {follower.settings.label}")


def _has_master(sites: Mapping[str, SiteSettings], heard: SiteSettings) -> bool:
    """Whether somebody named the master that was heard: that is no contradiction."""
    known = {(each.domain, each.master) for each in sites.values()}
    return (heard.domain, heard.master) in known


def _text(error: Exception) -> str:
    hint = f" ({error.hint})" if isinstance(error, HintedError) and error.hint else ""
    return printable(f"{error}{hint}")
