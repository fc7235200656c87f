"""All sites that a master follows: from its configuration, from its file, and announced. A shell.

A label that the configuration has prevails over the file's, and both over an announced one. An
announcement gives an address and the hint to dial now, nothing more: who answers there must be the
master of that name. One that is not heard any more is followed for as long as its facts may stay.
"""

import asyncio
import contextlib
import logging
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import AbstractAsyncContextManager
from dataclasses import replace
from typing import Any, Final, NamedTuple

from ca.errors import HintedError
from ca.names import MASTER
from rossec import clock, peer_limits, saved_statements
from rossec.discovery import Candidate, Candidates, listening, uri_of
from rossec.errors import ConfigurationError
from rossec.federation.exchange import Chains, OwnMaster
from rossec.federation.follower import FollowedSite
from rossec.federation.settings import FederationConfig, SiteFile, SiteSettings, checked_sites
from rossec.federation.site_state import LOST_FOR
from rossec.home import NodeHome
from rossec.host.runner import TaskSet
from rossec.master.server import MasterServer
from rossec.master.state.registry import is_connectable

SILENT: Final = 3.0  # seconds: a master announces itself twice in each


class _Heard(NamedTuple):
    settings: SiteSettings
    instance: bytes
    at: float


class AnnouncedMasters:
    """The masters heard while `listening` is entered; `candidates`: by default of the domain of `home`."""

    def __init__(self, home: NodeHome, candidates: Candidates | None = None) -> None:
        anchor = home.anchor()
        revoked = saved_statements.saved_revocations(home, anchor, clock.now()).entries
        self._candidates = Candidates(anchor, revoked) if candidates is None else candidates
        self._own_name = home.name
        self._heard: dict[str, _Heard] = {}
        self._returned: set[str] = set()

    def listening(self) -> AbstractAsyncContextManager[None]:
        return listening(self._candidates)

    def sites(self) -> tuple[SiteSettings, ...]:
        now, audible = time.monotonic(), dict[str, list[Candidate]]()
        for one in self._candidates.ranked(clock.now(), now):
            if one.name != self._own_name and one.rtt is not None and one.age(now) < SILENT:
                audible.setdefault(one.name, []).append(one)
        for name, found in audible.items():
            self._note(name, found, now)
        self._heard = {k: each for k, each in self._heard.items() if now - each.at < LOST_FOR}
        return tuple(each.settings for _, each in sorted(self._heard.items()))

    def take_returned(self) -> set[str]:
        # The names of those heard again after a pause, or restarted, since the last call.
        returned, self._returned = self._returned, set()
        return returned

    def _note(self, name: str, found: list[Candidate], now: float) -> None:
        held = self._heard.get(name)
        # The address in use stays while it is heard: at a host with several links, or where another master
        # says that it has this name, the site would otherwise be dialled anew at each look.
        kept = [one for one in found if held is not None and uri_of(one) == held.settings.uri]
        one = (kept or found)[0]
        instance = one.announcement.instance
        if held is None or held.instance != instance or now - held.at > SILENT:
            self._returned.add(name)
        settings = held.settings if held is not None and kept else _settings(one)
        self._heard[name] = _Heard(settings, instance, now - one.age(now))


def _settings(one: Candidate) -> SiteSettings:
    label = one.name.removeprefix(MASTER).removeprefix("/") or MASTER.removeprefix("/")
    return SiteSettings(label[:32], uri_of(one), one.name)


_TICK: Final = 1.0
_ANNOUNCED: Final = "announced"
_log = logging.getLogger("rossec.federation")
_audit = logging.getLogger("rossec.audit")

# The sites of one origin as of now; raises ConfigurationError
ReadSites = Callable[[], Iterable[SiteSettings]]


class Mesh:
    """Follows every site of its `sources`, by what they are called, the one that prevails first."""

    # `announced`: the masters heard on the local links; None: they are not followed.
    def __init__(
        self, own: OwnMaster, sources: Mapping[str, ReadSites], announced: AnnouncedMasters | None = None
    ) -> None:
        self._own = own
        self._announced = announced
        heard: dict[str, ReadSites] = {} if announced is None else {_ANNOUNCED: announced.sites}
        self._sources = {**sources, **heard}
        self._last: dict[str, tuple[SiteSettings, ...]] = {}
        self._warned: dict[str, str] = {}
        self._followers: dict[str, tuple[FollowedSite, asyncio.Task[Any]]] = {}
        self._tasks = TaskSet()
        own.state.trust.domains.own_sites = lambda: [each.label for each in self._own_sites()]
        own.state.forwarded_ports.masters = lambda: {
            each.master: each.uri for each in self._own_sites() if is_connectable(each.uri, "http")
        }

    async def run(self) -> None:
        self._own.effects.on_new_lists.append(self._send_lists)
        listening = contextlib.nullcontext() if self._announced is None else self._announced.listening()
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
        # Of two sources with one label the first prevails: so it is entered last.
        sources = {site.label: name for name, sites in reversed(self._last.items()) for site in sites}
        rows = [
            {**follower.status(), "source": sources.get(label, "")}
            for label, (follower, _) in sorted(self._followers.items())
        ]
        return {"sites": rows, "problems": dict(self._warned)}

    def _step(self) -> None:
        self._update()
        returned = set() if self._announced is None else self._announced.take_returned()
        for relay in self._own.state.forwarded_ports.expire(self._own.state.now()):
            _audit.warning("relay %s is silent", relay)
        for follower, _ in self._followers.values():
            follower.tick()
            if not follower.settings.domain and follower.settings.master in returned:
                follower.wake()

    def _update(self) -> None:
        wanted = self._wanted()
        for label, (follower, task) in tuple(self._followers.items()):
            # Whatever was changed, it is another site: what was learnt under the old settings is dropped.
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
        found: dict[str, SiteSettings] = {}
        before, self._warned = self._warned, {}
        for name, source in self._sources.items():
            try:
                self._last[name] = tuple(source())
            except (ConfigurationError, OSError) as error:  # the last that was read stays
                self._warned[name] = _text(error)
            for each in self._last.get(name, ()):
                known = {(other.domain, other.master) for other in found.values()}
                # One that a person has named is followed as named, and not a second time by its announcement.
                if name != _ANNOUNCED or (each.domain, each.master) not in known:
                    self._add(found, each)
        for where, text in self._warned.items():
            if before.get(where) != text:
                _log.warning("%s: %s", where, text)
        return found

    def _add(self, found: dict[str, SiteSettings], each: SiteSettings) -> None:
        where = f"site {each.label}"
        try:
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
            checked_sites([*found.values(), each])
        except ConfigurationError as error:
            self._warned[where] = _text(error)
            return
        found[each.label] = each

    def _own_sites(self) -> list[SiteSettings]:
        found = [follower.settings for follower, _ in self._followers.values()]
        return [each for each in found if not each.domain]

    def _send_lists(self) -> None:
        for follower, _ in self._followers.values():
            self._tasks.spawn(follower.send_lists(), f"lists for {follower.settings.label}")


def _text(error: Exception) -> str:
    hint = f" ({error.hint})" if isinstance(error, HintedError) and error.hint else ""
    return peer_limits.printable(f"{error}{hint}")


def mesh_of(server: MasterServer, home: NodeHome, config: FederationConfig) -> Mesh:
    """The mesh of `server`, not yet running; with `config` and the file in `home`."""
    chains = Chains()
    context = replace(server.context, verify=chains.recording(server.context.verify))
    own = OwnMaster(
        server.state, server.effects, context, server.mirror, server.drop_mirror, chains, home.grants
    )
    sources: Mapping[str, ReadSites] = {
        "configuration": lambda: config.sites,
        "file": SiteFile(home.path).sites,
    }
    announced = AnnouncedMasters(home) if config.follow_announced else None
    return Mesh(own, sources, announced)
