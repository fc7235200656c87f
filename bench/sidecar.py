"""Unmodified roscpp talker and listener: direct, through two sidecars, through two stunnels (TLS).

One run, interleaved: in each round every way is measured at every size, over a connection of its
own. A ratio is the median over the rounds of what two ways did in the same round, so that other
load hits both; `spread` is its quartiles. The talker is as fast as the listener receives. The
tunnel is configured with what it cannot discover, a slave API that names the stunnel's port.
`cpu_us` is what both processes of a tunnel used for a message, the kernel's part included. Memory
is that of one `rossec sidecar` with 1 and with 50 nodes of own identities, beside stock roscore; its private
memory (Private_Clean and Private_Dirty) is what it does not share with other programs of the host.
"""

import contextlib
import itertools
import tempfile
import time
from pathlib import Path
from statistics import median, quantiles
from typing import Any, Final

from bench._ways import SIZES, WAYS, Ways, master, registered
from grants.model import Right
from rossec.host.local_ports import free_port

NODES: Final = 50
ROUNDS: Final = 11


def _resident(process: int) -> float:
    """Resident memory in MB."""
    status = Path(f"/proc/{process}/status").read_text()
    (line,) = (line for line in status.splitlines() if line.startswith("VmRSS"))
    return int(line.split()[1]) / 1024


def private(process: int) -> float:
    """Memory in MB that no other process shares: what one more sidecar costs a host."""
    rollup = Path(f"/proc/{process}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in rollup if line.startswith("Private_")) / 1024


def _register(uri: str, name: str) -> None:
    own = f"http://127.0.0.1:{free_port()}/"
    for method, topic in (("registerPublisher", f"{name}/out"), ("registerSubscriber", "/in")):
        code, status, _ = getattr(master(uri), method)(name, topic, "std_msgs/String", own)
        assert code == 1, status


def memory(ways: Ways) -> dict[str, float]:
    """Of one sidecar with so many nodes, and of stock roscore."""
    names = [f"/node{number}" for number in range(NODES)]
    for name in names:
        ways.site.publish(name, f"{name}/out")
        ways.site.grant(name, Right.SUBSCRIBE, "/in")
    found: dict[str, float] = {}
    sidecar, uri = ways.host_sidecar()
    _register(uri, names[0])
    found["1"], found["private 1"] = round(_resident(sidecar.pid), 1), round(private(sidecar.pid), 1)
    for name in names[1:]:
        _register(uri, name)
    time.sleep(2)
    found[str(NODES)] = round(_resident(sidecar.pid), 1)
    found[f"private {NODES}"] = round(private(sidecar.pid), 1)
    core, uri = ways.stock_master()
    rosout = ways.start(uri, "/usr/lib/rosout/rosout")
    registered(uri, "/rosout")
    for name in names:
        _register(uri, name)
    found["roscore"] = round(_resident(core.pid) + _resident(rosout.pid), 1)
    return found


class Received:
    """What was received in each round, by way and by size (or "slow")."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], list[dict[str, float]]] = {}

    def add(self, way: str, label: str, found: dict[str, float]) -> None:
        """Another round."""
        self._found.setdefault((way, label), []).append(found)

    def _pairs(self, label: str, key: str, way: str, other: str) -> list[tuple[float, float]]:
        both = (self._found[each, label] for each in (way, other))
        return [(ours[key], theirs[key]) for ours, theirs in zip(*both, strict=True)]

    def _ratios(self, label: str, other: str) -> list[float]:
        pairs = self._pairs(label, "mb_per_s", "sidecar", other)
        return [ours / theirs for ours, theirs in pairs]

    def middle(self, way: str, label: str, key: str) -> float:
        """The median of one figure."""
        return round(median(found[key] for found in self._found[way, label]), 1)

    def throughput_versus(self, other: str) -> dict[str, float]:
        """The sidecar's, by size."""
        return {label: round(median(self._ratios(label, other)), 2) for label in SIZES}

    def spread(self, label: str, other: str) -> list[float]:
        """The quartiles of that."""
        low, _, high = quantiles(self._ratios(label, other))
        return [round(low, 2), round(high, 2)]

    def added(self, way: str) -> float:
        """How much older messages are than without a tunnel."""
        pairs = self._pairs("slow", "age_us", way, "plain")
        return round(median(ours - plain for ours, plain in pairs), 1)


def measure(seconds: float) -> dict[str, Any]:
    """All ways, sizes and memories."""
    each = max(0.2, seconds / (ROUNDS * len(WAYS) * (len(SIZES) + 1)))
    topics = {label: f"/s{size}" for label, size in SIZES.items()} | {"slow": "/slow"}
    heard = Received()
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        ways = Ways(directory, stack)
        for number in range(ROUNDS + 1):
            for (label, topic), way in itertools.product(topics.items(), WAYS):
                found = ways.listen(way, topic, each)
                if number > 0:  # the first round warms up
                    heard.add(way, label, found)
        resident = memory(ways)
    return {
        "megabytes_per_s": {
            way: {label: heard.middle(way, label, "mb_per_s") for label in SIZES} for way in WAYS
        },
        "throughput_vs_stunnel": heard.throughput_versus("stunnel"),
        "throughput_vs_plain": heard.throughput_versus("plain"),
        "spread": {
            f"{label} vs {other}": heard.spread(label, other) for label in SIZES for other in WAYS[:2]
        },
        "cpu_us": {way: {label: heard.middle(way, label, "cpu_us") for label in topics} for way in WAYS[1:]},
        "latency_us_p50": {way: heard.middle(way, "slow", "age_us") for way in WAYS},
        "latency_added_us_p50": heard.added("sidecar"),
        "latency_added_by_stunnel_us_p50": heard.added("stunnel"),
        "rss_mb": {"1": resident["1"], str(NODES): resident[str(NODES)]},
        "private_mb": {"1": resident["private 1"], str(NODES): resident[f"private {NODES}"]},
        "rss_vs_roscore": round(resident[str(NODES)] / resident["roscore"], 2),
        "rss_roscore_mb": resident["roscore"],
    }
