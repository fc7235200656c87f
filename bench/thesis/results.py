"""From times of sending and arrival to the figures of the thesis. Pure.

A point holds when at least 99 % of its messages arrive at their receivers and the queue does not
grow: the time a message takes may not rise by more than a tenth of the time that has passed.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from bench.thesis.talk import Point

ARRIVED: Final = 0.99
GROWTH: Final = 0.1  # seconds by which latency may rise in a second
SPAN: Final = 0.96  # of all messages, as in Figs. 5.5 to 5.8


@dataclass(frozen=True)
class Measured:
    """What became of a point; milliseconds.

    Attributes:
        mean: over every message at every receiver.
        low: with `high` the span that holds 96 % of them.
        last: mean of the time until the last receiver had a message.
        arrived: part of the messages that arrived, of all receivers.
        growth: seconds by which the latency rose in a second.
    """

    size: int
    rate: float
    mean: float
    low: float
    high: float
    last: float
    arrived: float
    growth: float

    @property
    def holds(self) -> bool:
        """Whether the link can carry this for ever."""
        return self.arrived >= ARRIVED and self.growth <= GROWTH

    @property
    def spread(self) -> float:
        """Width of the span."""
        return self.high - self.low

    def as_json(self) -> dict[str, Any]:
        """All of it, and whether it holds."""
        return {**asdict(self), "holds": self.holds}


def measured(point: Point, sent: Sequence[float], receivers: Sequence[Mapping[int, float]]) -> Measured:
    """What became of a point.

    Args:
        sent: when each message was sent, in seconds.
        receivers: when each message arrived at each of them, by its number.
    """
    taken = sorted(at - sent[number] for receiver in receivers for number, at in receiver.items())
    if not taken:
        return Measured(point.size, point.rate, 0, 0, 0, 0, 0, 0)
    by_message = {
        number: [found[number] - begin for found in receivers if number in found]
        for number, begin in enumerate(sent)
    }
    means = [(sent[n], sum(each) / len(each)) for n, each in by_message.items() if each]
    lasts = [max(each) for each in by_message.values() if len(each) == len(receivers)]
    edge = (1 - SPAN) / 2
    return Measured(
        point.size,
        point.rate,
        _ms(sum(taken) / len(taken)),
        _ms(quantile(taken, edge)),
        _ms(quantile(taken, 1 - edge)),
        _ms(sum(lasts) / len(lasts)) if lasts else 0.0,
        round(len(taken) / (len(sent) * len(receivers)), 4),
        round(growth(means), 3),
    )


def quantile(ordered: Sequence[float], part: float) -> float:
    """The value below which `part` of them are, by the nearest rank."""
    return ordered[min(len(ordered) - 1, round(part * (len(ordered) - 1)))]


def growth(means: Sequence[tuple[float, float]]) -> float:
    """The slope of the line nearest to (time, value) by least squares; 0 for a single one."""
    count = len(means)
    middle = sum(at for at, _ in means) / count
    level = sum(value for _, value in means) / count
    width = sum((at - middle) ** 2 for at, _ in means)
    if not width:
        return 0.0
    return sum((at - middle) * (value - level) for at, value in means) / width


def largest(points: Sequence[Measured], rate: float = 1.0) -> int:
    """The largest size that holds at a rate, of those below the first that does not; else 0."""
    found = 0
    for each in sorted((p for p in points if p.rate == rate), key=lambda p: p.size):
        if not each.holds:
            break
        found = each.size
    return found


def copies(received: int, point: Point) -> float:
    """How often a message passed a link, by the bytes counted there."""
    return round(received / (point.size * point.count), 2)


def _ms(seconds: float) -> float:
    return round(seconds * 1000, 3)
