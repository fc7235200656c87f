"""Our master, secured, beside Debian's rosmaster, plain: the same calls, in turn, in one run.

`ops_vs_rosmaster` is ours through stock's calls per second of wall clock, `..._cpu` the same per
second of processor time, which others on the machine do not disturb. A closed loop of eight
connections (one with one node); every figure is the median of the rounds' ratios.
`compact_*`: the same calls in the compact form, `compact_cpu_vs_xmlrpc` its processor time through
XML-RPC's at our master (wanted: 0.5), `compact_caller_cpu_vs_xmlrpc` the same of its caller,
`compact_bytes` what is in the channel.
Wanted: at least 2 times stock; memory at most 1.3 times stock's plus 10 kB a node; updates below
50 ms with 50 dead nodes; 99 of 100 of 100 connections cut within 250 ms of a revocation, and of
1,000 within 60 ms of the list's arrival at the node (`links_1000`; `cut_cpu` is not disturbed by others).
"""

import asyncio
import resource
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import median
from typing import Any

from bench import _population
from bench._callers import caller_cpu
from bench._latency import node_environ, plain_updates, secure_updates
from bench._lines import Call, CompactLine, Line, SecureLine, drive, request
from bench._masters import EnrolledNode, Master, enroll, ours, stock
from bench._revocations import revocation
from rossec.master.server.server import TIMESTAMP_EVERY
from rossec.ros import xmlrpc
from tests.support.site import Site

COUNTS = (1, 100, 1000)
CONNECTIONS = (1, 10, 100, 1000)
LINES = 8
SETTLED = 60  # seconds, at most
EACH = 60  # requests of one line in one block
TYPE = "std_msgs/String"

Work = Callable[[int, int], Call]


def works(names: list[str], count: int) -> dict[str, Work]:
    """The operations: request of line `k`, number `i` of its block."""

    def uri(k: int) -> str:
        return f"http://127.0.0.1:{30000 + k}/"

    def other(k: int, i: int) -> str:
        return f"/n{(37 * i + k) % count}"

    return {
        "registerPublisher": lambda k, i: ("registerPublisher", names[k], f"{names[k]}/t{i}", TYPE, uri(k)),
        "unregisterPublisher": lambda k, i: ("unregisterPublisher", names[k], f"{names[k]}/t{i}", uri(k)),
        "lookupNode": lambda k, i: ("lookupNode", names[k], other(k, i)),
        "lookupService": lambda k, i: ("lookupService", names[k], f"{other(k, i)}/reset"),
        "setParam": lambda k, i: ("setParam", names[k], f"{names[k]}/p{i % 20}", i),
        "getParam": lambda k, i: ("getParam", names[k], f"{other(k, i)}/rate"),
        "getSystemState": lambda k, _: ("getSystemState", names[k]),
    }


class Side:
    """One master with its lines, and what they took."""

    def __init__(self, master: Master, lines: list[Line]) -> None:
        self.master = master
        self.lines = lines
        self.wall: dict[str, list[float]] = defaultdict(list)
        self.cpu: dict[str, list[float]] = defaultdict(list)

    def run(self, name: str, work: Work, each: int) -> None:
        """One block: calls per second of wall clock and of the master's processor time."""
        requests = [[line.write(work(k, i)) for i in range(each)] for k, line in enumerate(self.lines)]
        calls, used = each * len(self.lines), self.master.cpu()
        self.wall[name].append(calls / drive(self.lines, requests))
        self.cpu[name].append((self.master.cpu() - used) / calls)


def ratios(first: Side, second: Side) -> tuple[dict[str, float], dict[str, float]]:
    """By operation: calls per second, wall clock and processor time."""
    wall = {
        name: median(a / b for a, b in zip(first.wall[name], second.wall[name], strict=True))
        for name in first.wall
    }
    cpu = {name: sum(second.cpu[name]) / sum(first.cpu[name]) for name in first.cpu}
    return _rounded(wall), _rounded(cpu)


def sizes(lines: Sequence[Line], work: Work) -> dict[str, int]:
    """Bytes of a call and of its answer, inside the channel, with XML-RPC and the compact form."""
    found: dict[str, int] = {}
    for kind, line in zip(("xmlrpc", "compact"), lines, strict=True):
        call = line.write(work(0, 0))
        for each in line.ready([call]):
            line.sock.sendall(each)
        while (answer := line.answer()) is None:
            pass
        assert isinstance(line, SecureLine)
        unit = line.unit(answer)
        if isinstance(line, CompactLine):
            line.check(unit)
        found |= {f"{kind}_call": len(call), f"{kind}_answer": len(unit)}
    return found


def _rounded(figures: dict[str, float]) -> dict[str, float]:
    return {name: round(value, 2) for name, value in figures.items()}


def operations(site: Site, folder: Path, count: int, seconds: float) -> dict[str, Any]:
    """Calls and memory with `count` nodes."""
    members = [enroll(site, f"/n{i}") for i in range(count)]
    callers = [enroll(site, f"/caller{k}") for k in range(min(count, LINES))]
    names = [member.name for member in callers]
    with ExitStack() as stack:
        secured, plain = stack.enter_context(ours(site)), stack.enter_context(stock(folder))
        stack.enter_context(_population.secure(members, secured.port, site.anchor.certificate))
        stack.enter_context(_population.plain([member.name for member in members], plain.port))
        _settle(secured)
        memory = secured.rss(), plain.rss()
        sides = (
            Side(secured, [_secure_line(secured.port, site, caller) for caller in callers]),
            Side(plain, [Line(plain.port) for _ in callers]),
            Side(secured, [_compact_line(secured.port, site, caller) for caller in callers]),
        )
        end = time.monotonic() + seconds
        while True:
            for name, work in works(names, count).items():
                each = EACH if name != "getSystemState" else max(4, EACH // count)
                for side in sides:
                    side.run(name, work, each)
            if time.monotonic() > end:
                break
        xml, stock_side, small = sides
        wall, cpu = ratios(xml, stock_side)
        small_wall, small_cpu = ratios(small, stock_side)
        ours_wall = {name: round(median(rates)) for name, rates in xml.wall.items()}
        lines = xml.lines[0], small.lines[0]
        return {
            "ops_vs_rosmaster": wall,
            "ops_vs_rosmaster_cpu": cpu,
            "ops_per_s": ours_wall,
            "compact_vs_rosmaster": small_wall,
            "compact_vs_rosmaster_cpu": small_cpu,
            "compact_per_s": {name: round(median(rates)) for name, rates in small.wall.items()},
            "compact_cpu_vs_xmlrpc": _rounded(
                {name: sum(used) / sum(xml.cpu[name]) for name, used in small.cpu.items()}
            ),
            "compact_bytes": {name: sizes(lines, work) for name, work in works(names, count).items()},
            "compact_caller_cpu_vs_xmlrpc": caller_cpu(
                secured,
                callers[0],
                site.anchor,
                {name: work(0, 0) for name, work in works(names, count).items()},
                count,
            ),
            "rss_kb": memory[0],
            "rss_kb_rosmaster": memory[1],
            "rss_vs_rosmaster": round(memory[0] / memory[1], 2),
            "rss_allowed_kb": round(1.3 * memory[1] + 10 * count),
        }


def _settle(master: Master) -> None:
    """Wait until every node has been called once and confirmed its list, which is done in beats."""
    time.sleep(TIMESTAMP_EVERY + 1)
    end = time.monotonic() + SETTLED
    while time.monotonic() < end:
        before = master.cpu()
        time.sleep(1)
        if master.cpu() - before < 0.05:
            return


def _secure_line(port: int, site: Site, member: EnrolledNode) -> SecureLine:
    line = SecureLine(port, member.credentials, site.anchor.verify)
    body = line.ask(request("rossec.presentGrants", member.name, [member.grant]))
    assert xmlrpc.load_response(body) == [1, "grants accepted", 1]
    return line


def _compact_line(port: int, site: Site, member: EnrolledNode) -> CompactLine:
    """Its grants were presented on the other connection: they count for the key."""
    return CompactLine(member.name, port, member.credentials, site.anchor.verify)


def updates(site: Site, folder: Path) -> dict[str, Any]:
    """Milliseconds to a live subscriber beside dead ones; what stock never delivers is a bound."""
    found: dict[str, Any] = {}
    for dead in (0, 50):
        with ours(site) as secured, stock(folder) as plain:
            found[f"update_ms_{dead}_dead"] = asyncio.run(secure_updates(site, secured, dead))
            found[f"update_ms_{dead}_dead_rosmaster"] = plain_updates(plain, dead)
    return found


def revocations(site: Site) -> dict[str, Any]:
    """By number of connections of one publisher, of which all end; `links_1000`: some of a thousand."""

    def found(count: int, revoked: int) -> dict[str, float]:
        with ours(site) as master:
            return asyncio.run(revocation(site, node_environ(site, master), count, revoked))

    by_count = {count: found(count, count) for count in CONNECTIONS}
    some = {str(revoked): found(1000, revoked) for revoked in (1, 100)}
    return {
        "revoke_ms": by_count,
        "revoke_ms_p50": by_count[100]["from_master_p50"],
        "revoke_ms_p99": by_count[100]["from_master_p99"],
        "links_1000": {**some, "all": by_count[1000]},
    }


def measure(seconds: float) -> dict[str, Any]:
    """All of it; the keys without a number of nodes are those of 100 nodes or connections."""
    resource.setrlimit(resource.RLIMIT_NOFILE, (resource.getrlimit(resource.RLIMIT_NOFILE)[1],) * 2)
    with tempfile.TemporaryDirectory() as folder:
        site = Site(Path(folder) / "site")
        latency = updates(site, Path(folder)) | revocations(site)
        found = {count: operations(site, Path(folder), count, seconds / 4) for count in COUNTS}
    usual = found[100]
    return {
        "ops_vs_rosmaster": usual["ops_vs_rosmaster"],
        "compact_cpu_vs_xmlrpc": usual["compact_cpu_vs_xmlrpc"],
        "compact_caller_cpu_vs_xmlrpc": usual["compact_caller_cpu_vs_xmlrpc"],
        "compact_bytes": usual["compact_bytes"],
        "rss_vs_rosmaster": usual["rss_vs_rosmaster"],
        **latency,
        "by_nodes": found,
    }
