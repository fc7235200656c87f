"""Experiments 5.2.1 to 5.2.4: latency by size and rate, and the largest message at 1 Hz.

A short run measures few sizes, those about which the thesis says something; a sweep goes by powers
of ten through sizes and rates, the whole one by the steps of 1, 2, 5. At each rate sizes are tried
upwards until one does not hold: above it nothing would.
"""

import time
from collections.abc import Iterable, Iterator
from typing import Any, Final

from bench.thesis.claims import small
from bench.thesis.results import Measured, copies, largest, measured
from bench.thesis.table import Running
from bench.thesis.talk import Point

SIZES: Final = (0, *(step * 10**power for power in range(2, 7) for step in (1, 2, 5)))
RATES: Final = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
MESSAGES: Final = 200  # of a point of a whole run
LONGEST: Final = 60.0  # seconds of a point
DRAIN: Final = 2.0  # seconds for what is on its way after the last was sent
SETTLED: Final = 120.0  # seconds at most until a full link is idle: ten messages of a publisher
_IDLE: Final = 20_000  # bytes a second
_SWEPT: Final = ((1, 8), (10, 50), (100, 200))  # rates of a sweep, with how many messages
_LADDERS: Final = {
    "direct_100m": (1_000_000, 2_000_000, 3_000_000),
    "plain_100m": (1_000_000,),
    "gateway_100m": (2_000_000, 3_000_000),
    "relay_100m": (1_000_000, 2_000_000),
    "direct_300k": (5_000, 10_000),
    "gateway_300k": (20_000, 30_000),
    "relay_300k": (10_000,),
}
_FAST: Final = (Point(100, 20, 30), Point(1_000, 20, 30), Point(10_000, 20, 30))
_SLOW: Final = (Point(100, 10, 20), Point(1_000, 2, 6))
_WARM: Final = Point(100, 20, 10)


def short(name: str) -> Iterator[list[Point]]:
    """The points of a short run: small messages, then a ladder at 1 Hz."""
    yield from ([each] for each in (_SLOW if name.endswith("_300k") else _FAST))
    yield [Point(size, 1, 5) for size in _LADDERS[name]]


def sweep(name: str) -> Iterator[list[Point]]:
    """The ladders of a sweep; at 1 Hz also what a short run tries."""
    for rate, count in _SWEPT:
        tens = {size for size in SIZES if size in (0, 5_000_000) or str(size).startswith("1")}
        sizes = tens | set(_LADDERS[name]) if rate == 1 else tens
        yield [Point(size, rate, count) for size in sorted(sizes)]


def whole(_name: str) -> Iterator[list[Point]]:
    """The ladders of a whole run, one for each rate; the same for every set-up."""
    for rate in RATES:
        count = min(MESSAGES, round(LONGEST * rate))
        yield [Point(size, rate, count) for size in SIZES]


EXTENTS: Final = {"short": short, "sweep": sweep, "full": whole}


def climb(made: Running, ladders: Iterable[list[Point]]) -> dict[str, Any]:
    """The figures of a set-up that runs."""
    found, passed, number = list[Measured](), dict[str, float](), 1
    _one(made, 0, _WARM)
    for ladder in ladders:
        if found and not found[-1].holds:
            _settle(made)
        for point in ladder:
            before = made.counted()
            row = _one(made, number, point)
            number += 1
            found.append(row)
            if not row.holds:
                break
            if point.size >= 1000:
                passed[str(point.size)] = copies(made.counted() - before, point)
    size = largest(found)
    return {
        "largest": size,
        "copies": min(passed.values(), default=0.0),
        "copies_on_link": passed,
        "latency_ms": [each.as_json() for each in found],
        **small(made.name, found),
    }


def _one(made: Running, number: int, point: Point) -> Measured:
    """Send a point, and collect what arrived."""
    order = {"size": point.size, "rate": point.rate, "count": point.count}
    sent: list[float] = made.talker.ask(point.seconds + 30, number=number, point=order)
    end = time.monotonic() + DRAIN
    while True:
        answers = [each.ask(number=number) for each in made.listeners]
        if all(len(each) == point.count for each in answers) or time.monotonic() > end:
            break
        time.sleep(0.1)
    for each in made.listeners:
        each.ask(number=number, last=True)
    return measured(point, sent, [{int(n): at for n, at in each.items()} for each in answers])


def _settle(made: Running) -> None:
    """Wait until the link is idle: what still waits would delay the next point."""
    before, end = -_IDLE - 1, time.monotonic() + SETTLED
    while (now := made.counted()) - before > _IDLE and time.monotonic() < end:
        before = now
        time.sleep(1)
