"""What time it is, for all that begins and ends: never earlier than the time that has passed.

Grants, certificates, timestamps and deadlines are judged by the host's clock, and that can be set
back (by its operator, by NTP, by whoever speaks for NTP): what should have ended would go on. So
the clock of this process is the host's, or the latest it ever showed and the seconds counted since,
whichever is later. The seconds come from CLOCK_BOOTTIME, which nobody sets and which goes on while
the machine is suspended. They count `DRIFT` slower, since counters and clocks are never quite alike
(adjtimex(2) corrects 500 ppm at most): a small step back is made good by itself.

A clock that went back by more than `SKEW` is a *setback*: it is counted, and whoever relies on news
relies on them no longer until they are confirmed (`rossec.participant.revocation_watch`). If the
clock was wrong before, and not now, then another clock says so: `correct` takes the host's word
again.
"""

import time as _time
from collections.abc import Callable
from functools import partial
from typing import Final

from ca.revocation.state import SKEW

DRIFT: Final = 500e-6

Seconds = Callable[[], float]


def counter() -> Seconds:
    """Counts seconds since some moment, those included in which the machine was suspended."""
    if hasattr(_time, "CLOCK_BOOTTIME"):
        return partial(_time.clock_gettime, _time.CLOCK_BOOTTIME)
    return _time.monotonic


class Clock:
    """A host's clock; threads may share it, for all it knows is replaced in one step.

    Args:
        host: seconds since the epoch, as the host has them.
        elapsed: seconds of a clock that cannot be set; this machine's.
    """

    def __init__(self, host: Seconds = _time.time, elapsed: Seconds | None = None) -> None:
        self._host = host
        self._elapsed = counter() if elapsed is None else elapsed
        self._latest = host(), self._elapsed()
        self._behind = 0.0  # by how much the host's clock is known to be behind
        self.setbacks = 0

    def time(self) -> float:
        """Seconds since the epoch."""
        host, elapsed = self._host(), self._elapsed()
        latest, then = self._latest
        counted = latest + (elapsed - then) * (1 - DRIFT)
        if host >= counted:
            self._latest, self._behind = (host, elapsed), 0.0
            return host
        if counted - host > self._behind + SKEW:
            self._behind = counted - host
            self.setbacks += 1
        return counted

    def correct(self, moment: int) -> bool:
        """Another clock, that is believed, shows `moment` just now; whether that corrects this one.

        It does where the host's clock agrees with the other, and was set back.
        """
        host, elapsed = self._host(), self._elapsed()
        corrects = abs(host - moment) <= SKEW and host < self.time()
        if corrects:
            self._latest, self._behind = (host, elapsed), 0.0
        return corrects


HOST = Clock()


def time() -> float:
    """Seconds since the epoch, by the clock of this process."""
    return HOST.time()


def now() -> int:
    """The same in whole seconds; never ROS time (attack M7)."""
    return int(HOST.time())


def correct(moment: int) -> bool:
    """As of `Clock`."""
    return HOST.correct(moment)


class Setbacks:
    """Tells one part of a process of setbacks, each once."""

    def __init__(self) -> None:
        self._seen = HOST.setbacks

    def any_new(self) -> bool:
        """Whether there was one since the last question."""
        HOST.time()  # which notices
        seen, self._seen = self._seen, HOST.setbacks
        return self._seen != seen
