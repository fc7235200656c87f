"""What the thesis says in chapter 5: its figures, and the statements of 5.2.5 as ratios. Pure.

The thesis has no tables, and the curves of Figs. 5.5 to 5.8 are not in its text: these values are
all it gives. A statement holds or not by a ratio of two figures of one run, so that the speed of
the machine cancels. Ways by which messages are not sent once for each link (`relay`: each receiver
has its own sealed connection) are held only to the statements that can be true of them.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

from bench.thesis.results import Measured

LARGEST: Final = {  # bytes at 1 Hz, thesis 5.2.1 to 5.2.4
    "direct_100m": 1_000_000,
    "gateway_100m": 2_000_000,
    "direct_300k": 5_000,
    "gateway_300k": 20_000,
}
LATENCY: Final = {
    "direct_100m": "at least 2 ms, from 1000 bytes 10 ms",
    "gateway_100m": "at least 7 ms, from 10 kB over 10 ms",
    "direct_300k": "tens of ms, large variance",
    "gateway_300k": "below 2000 bytes 10 to 20 ms, smaller variance",
}
MEMORY: Final = {  # MB, and kB for each node; thesis 5.1
    "full": (54.5, 4.5),
    "proxy": (8.9, 0.0),
}
MEASURED: Final = {"full": "full", "sidecar": "proxy"}
"""Which program of ours takes the part of which of the thesis."""
EQUIVALENT: Final = {"plain_100m": "direct_100m", "relay_100m": "gateway_100m", "relay_300k": "gateway_300k"}
"""The experiment of the thesis that a set-up of ours repeats in another way."""

Rows = Mapping[str, Mapping[str, Any]]
SMALL: Final = {"100m": 100, "300k": 1000}
"""Bytes of the messages whose latency and variance are compared. By radio they have to be as large
as what the token bucket lets through at once: six times less than that meets no slow link here, as
the bridges of the thesis had a latency of their own, and ours have a rate alone. By Ethernet the
thesis compares what latencies are not below: the lower end of the span."""


@dataclass(frozen=True)
class Statement:
    """One of 5.2.5: `figure` of `over` divided by that of `under`."""

    text: str
    figure: str
    over: str
    under: str
    holds: Callable[[float], bool]
    bound: str


def statements(routed: str) -> dict[str, Statement]:
    """Those that can be true of a way: `gateway` or `relay`."""
    found = {
        "larger_300k": Statement(
            "routed sends larger messages by radio",
            "largest",
            f"{routed}_300k",
            "direct_300k",
            lambda x: x > 1,
            "> 1",
        ),
        "radio_no_slower": Statement(
            "by radio no additional latency is seen",
            "mean",
            f"{routed}_300k",
            "direct_300k",
            lambda x: x <= 1.25,
            "<= 1.25",
        ),
        "radio_variance": Statement(
            "by radio the variance of the latency is smaller",
            "spread",
            f"{routed}_300k",
            "direct_300k",
            lambda x: x < 1,
            "< 1",
        ),
        "ethernet_slower": Statement(
            "by Ethernet there is an additional latency",
            "low",
            f"{routed}_100m",
            "direct_100m",
            lambda x: x > 1,
            "> 1",
        ),
        "less_at_the_origin": Statement(
            "less data at the interface of the publisher's site",
            "copies",
            f"{routed}_300k",
            "direct_300k",
            lambda x: x < 1,
            "< 1",
        ),
    }
    if routed == "gateway":
        found["larger_100m"] = Statement(
            "routed sends larger messages by Ethernet",
            "largest",
            "gateway_100m",
            "direct_100m",
            lambda x: x > 1,
            "> 1",
        )
    return found


def judged(rows: Rows, routed: str) -> dict[str, dict[str, Any]]:
    """Each statement: its text, the ratio, and whether it holds; None: it was not measured.

    Args:
        rows: of each set-up: `largest`, `copies`, and `mean`, `low`, `spread` of small messages.
    """
    return {name: _judge(rows, each) for name, each in statements(routed).items()}


def _judge(rows: Rows, statement: Statement) -> dict[str, Any]:
    over, under = (rows.get(row, {}).get(statement.figure) for row in (statement.over, statement.under))
    if not over or not under:
        return {"says": statement.text, "ratio": None, "bound": statement.bound, "holds": None}
    ratio = over / under
    return {
        "says": statement.text,
        "ratio": round(ratio, 2),
        "bound": statement.bound,
        "holds": statement.holds(ratio),
    }


def failed(result: Mapping[str, Any]) -> list[str]:
    """The statements of a result that were measured and do not hold."""
    return [
        f"{way} {name}: {row['says']}: {row['ratio']}, not {row['bound']}"
        for way, rows in result.get("statements", {}).items()
        for name, row in rows.items()
        if row["holds"] is False
    ]


def small(name: str, points: Sequence[Measured]) -> dict[str, float]:
    """Mean, lower end and width of the span of small messages; empty if there were none."""
    for each in sorted(points, key=lambda point: point.rate):
        if each.size == SMALL[name.rpartition("_")[2]] and each.holds:
            return {"mean": each.mean, "low": each.low, "spread": each.spread}
    return {}
