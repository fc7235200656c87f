"""Who wants to know when somebody comes and goes, and gets only that messages come.

A stream of ten messages a second while somebody is there. The watcher has a day with the truth to
learn by, fits to it how long before and after a message somebody is there, and by how much the
first message is late; then it is tried on another day.
"""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Final

import numpy as np
import numpy.typing as npt

from bench._views import received, text
from grants.model import Restriction

RATE: Final = 10
_STAY: Final = 400  # seconds on average that somebody is there, and away
_TYPE: Final = "std_msgs/String"
NEAR: Final = 5.0  # seconds within which a moment is called known

Span = tuple[float, float]


def day(seed: int, seconds: int) -> list[Span]:
    """From when to when somebody is there; a tenth of the visits is one message only."""
    rng = np.random.default_rng(seed)
    found, now = [], float(rng.exponential(_STAY))
    while now < seconds:
        stay = 0.0 if rng.random() < 0.1 else float(rng.exponential(_STAY))
        found.append((now, min(now + stay, float(seconds))))
        now += stay + 30 + float(rng.exponential(_STAY))
    return found


def _messages(spans: Sequence[Span]) -> Iterator[tuple[float, bytes]]:
    for start, end in spans:
        for number in range(int((end - start) * RATE) + 1):
            yield start + number / RATE, text(b"somebody is there")


def watched(restriction: Restriction, seconds: int) -> dict[str, dict[str, float]]:
    """The share of seconds of which it is known whether somebody is there, and of moments."""
    days = {seed: day(seed, seconds) for seed in (3, 4)}
    arrivals = {
        seed: np.array([at for at, _ in received(_TYPE, restriction, _messages(spans))])
        for seed, spans in days.items()
    }
    before, after = _fitted(arrivals[3], _there(days[3], seconds))
    late = _lateness(arrivals[3], days[3])
    there = _there(days[4], seconds)
    often = bool(_there(days[3], seconds).mean() >= 0.5)
    told = arrivals[4]
    return {
        "presence_accuracy": {
            "naive": _share(_around(told, 0, 1, seconds) == there),
            "prior": _share(there == often),
            "attacker": _share(_around(told, before, after, seconds) == there),
        },
        # How many of those who came are known to have come within 5 s of a moment.
        "arrivals_told": {
            "naive": _moments(told, days[4], 0.0),
            "prior": round(len(days[4]) * 2 * NEAR / seconds, 3),
            "attacker": _moments(told, days[4], late),
        },
    }


def _share(right: npt.NDArray[np.bool_]) -> float:
    return round(float(right.mean()), 3)


def _there(spans: Sequence[Span], seconds: int) -> npt.NDArray[np.bool_]:
    found = np.zeros(seconds, bool)
    for start, end in spans:
        found[int(start) : int(end) + 1] = True
    return found


def _around(
    told: npt.NDArray[np.float64], before: float, after: float, seconds: int
) -> npt.NDArray[np.bool_]:
    found = np.zeros(seconds, bool)
    for at in told:
        found[max(0, int(at - before)) : int(at + after)] = True
    return found


def _fitted(told: npt.NDArray[np.float64], there: npt.NDArray[np.bool_]) -> Span:
    """The span around a message that fits best."""
    widths = (0, 1, 5, 10, 15, 30, 45, 60, 90, 120)
    choices = [(float(before), float(after)) for before in widths for after in widths[1:]]

    def right(span: Span) -> float:
        return float((_around(told, span[0], span[1], len(there)) == there).mean())

    return max(choices, key=right)


def first_messages(told: npt.NDArray[np.float64]) -> list[float]:
    """When those came that follow a pause."""
    gaps = [b - a for a, b in pairwise(told)]
    usual = float(np.median(gaps)) if gaps else 1.0
    later = [float(b) for a, b in pairwise(told) if b - a > 1.5 * usual + 1]
    return [*map(float, told[:1]), *later]


def _lateness(told: npt.NDArray[np.float64], spans: Sequence[Span]) -> float:
    starts = np.array([start for start, _ in spans])
    late = [at - starts[starts <= at].max() for at in first_messages(told) if (starts <= at).any()]
    return float(np.median(late)) if late else 0.0


def _moments(told: npt.NDArray[np.float64], spans: Sequence[Span], late: float) -> float:
    guesses = np.array([at - late for at in first_messages(told)] or [-np.inf])
    known = [np.abs(guesses - start).min() <= NEAR for start, _ in spans]
    return round(float(np.mean(known)), 3)
