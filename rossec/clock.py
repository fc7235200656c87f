"""The time of this process: the host's clock, but never set back.

Grants, certificates, timestamps and deadlines are checked against the host's clock, and that can be
set back (by its operator, by NTP, by an attacker of NTP): what has expired would be valid again. So
the time is that of the host's clock, or the latest it ever showed plus the seconds counted since,
whichever is later. A clock that went back by more than `SKEW` is a *setback*: it is counted, and
revocation data is not relied on until it is confirmed (`rossec.participant.connections`). If the
clock was wrong before and is right now, a trusted clock shows it: `correct` then follows it again.
"""

import time as _time
from collections.abc import Callable
from functools import partial
from typing import Final

from ca.revocation.trust_status import SKEW

# The counted seconds run slower, since counters and clocks differ (adjtimex(2) corrects 500 ppm at
# most): a small step back is caught up.
DRIFT: Final = 500e-6

Seconds = Callable[[], float]


def counter() -> Seconds:
    # CLOCK_BOOTTIME cannot be set, and runs while the machine is suspended.
    if hasattr(_time, "CLOCK_BOOTTIME"):
        return partial(_time.clock_gettime, _time.CLOCK_BOOTTIME)
    return _time.monotonic


class Clock:
    """A host's clock; threads may share it, as its state is replaced in one step."""

    def __init__(self, host: Seconds = _time.time, elapsed: Seconds | None = None) -> None:
        self._host = host  # seconds since the epoch, as the host has them
        # seconds of a clock that cannot be set; this machine's
        self._elapsed = counter() if elapsed is None else elapsed
        self._latest = host(), self._elapsed()
        self._behind = 0.0  # by how much the host's clock is known to be behind
        self.setbacks = 0

    def time(self) -> float:
        # Seconds since the epoch.
        host, elapsed = self._host(), self._elapsed()
        latest, then = self._latest
        counted = latest + (elapsed - then) * (1 - DRIFT)
        if host >= counted:
            self._latest, self._behind = (host, elapsed), 0.0
            return host
        if counted - host > self._behind + SKEW:
            self._behind = counted - host
            # Confirmations are dropped then: no new connection until the master confirms again (0013).
            self.setbacks += 1
        return counted

    def correct(self, moment: int) -> bool:
        # It is where the host's clock agrees with the other, and was set back.
        host, elapsed = self._host(), self._elapsed()
        # Of an answer to an own call alone: a push could be delayed until it agrees with any clock (0013).
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


def format_time(seconds: int) -> str:
    """A point in time for people, UTC."""
    return _time.strftime("%Y-%m-%d %H:%M:%S UTC", _time.gmtime(seconds))


def format_duration(seconds: int) -> str:
    """A duration for people, in its largest whole units: `14m 59s`, `2d 3h`."""
    parts = list[str]()
    for unit, size in (("d", 86400), ("h", 3600), ("m", 60), ("s", 1)):
        count, seconds = divmod(seconds, size)
        if count:
            parts.append(f"{count}{unit}")
    return " ".join(parts[:2]) or "0s"


def seconds_left_today(now: int) -> int:
    """Seconds until midnight, local time."""
    local = _time.localtime(now)
    return max(60, 86400 - (local.tm_hour * 3600 + local.tm_min * 60 + local.tm_sec))


def correct(moment: int) -> bool:
    return HOST.correct(moment)


class Setbacks:
    """Reports setbacks to one part of a process, each once."""

    def __init__(self) -> None:
        self._seen = HOST.setbacks

    def any_new(self) -> bool:
        """Whether there was one since the last call."""
        HOST.time()  # detects them
        seen, self._seen = self._seen, HOST.setbacks
        return self._seen != seen
