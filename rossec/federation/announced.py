"""Masters of the own domain that announce themselves on the local links, followed unasked.

A shell around `rossec.discovery`. An announcement gives an address and the hint to dial now,
nothing more: who answers there must be the master of that name. One that is not heard any more is
followed for as long as its facts may stay.
"""

import time
from contextlib import AbstractAsyncContextManager
from typing import Final, NamedTuple

from ca.names import MASTER
from rossec import clock
from rossec.discovery.candidates import Candidate, Candidates
from rossec.discovery.choose import uri_of
from rossec.discovery.finder import listening
from rossec.federation.settings import SiteSettings
from rossec.federation.states import LOST_FOR
from rossec.home import NodeHome
from rossec.saved_revocations import saved_revocations

SILENT: Final = 3.0  # seconds: a master announces itself twice in each


class _Heard(NamedTuple):
    settings: SiteSettings
    instance: bytes
    at: float


class AnnouncedMasters:
    """The masters heard while `listening` is entered.

    Args:
        home: of the own master.
        candidates: what is heard; by default of the domain of `home`.
    """

    def __init__(self, home: NodeHome, candidates: Candidates | None = None) -> None:
        anchor = home.anchor()
        revoked = saved_revocations(home, anchor, clock.now()).entries
        self._candidates = Candidates(anchor, revoked) if candidates is None else candidates
        self._own_name = home.name
        self._heard: dict[str, _Heard] = {}
        self._returned: set[str] = set()

    def listening(self) -> AbstractAsyncContextManager[None]:
        """Hear the local links within this context."""
        return listening(self._candidates)

    def sites(self) -> tuple[SiteSettings, ...]:
        """Those heard within the last minute, by name."""
        now = time.monotonic()
        for name, found in self._audible(now).items():
            self._note(name, found, now)
        self._heard = {k: each for k, each in self._heard.items() if now - each.at < LOST_FOR}
        return tuple(each.settings for _, each in sorted(self._heard.items()))

    def take_returned(self) -> set[str]:
        """The names of those heard again after a pause, or restarted, since the last call."""
        returned, self._returned = self._returned, set()
        return returned

    def _audible(self, now: float) -> dict[str, list[Candidate]]:
        """The candidates of each name that are heard now and were reached, the best first."""
        found: dict[str, list[Candidate]] = {}
        for one in self._candidates.ranked(clock.now(), now):
            if one.name != self._own_name and one.rtt is not None and one.age(now) < SILENT:
                found.setdefault(one.name, []).append(one)
        return found

    def _note(self, name: str, found: list[Candidate], now: float) -> None:
        """Keep the address that is followed while it is heard: links differ little."""
        held = self._heard.get(name)
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
