"""rospy as it is, secured by rossec, and through a TLS tunnel (stunnel), side by side.

Real processes on loopback: a publisher and a subscriber of each kind run at the same time and take
turns within every round. A sample is the time from the first `publish` to the last callback of a
burst that is queued without loss; a ratio is the median of the ratios of all turns. Bursts of large
messages are short, so they have several turns in a round; who begins alternates. `fanout10` has ten
subscriber processes, for rossec under three different filter plans. Latency is one way, at 100 Hz.
`node_...`: the built-in node on the same messages; a ratio is what it takes through what rospy with rossec
takes (wanted: 1.2 at most).
"""

import asyncio
import contextlib
import json
import socket
import statistics
import subprocess
import tempfile
import time
from collections import defaultdict
from collections.abc import AsyncIterator, Iterator, Sequence
from pathlib import Path
from typing import Any, Final

from bench._site import build as certificates
from grants.model import Restriction, Right, filter_rules
from tests.support import stock
from tests.support.fleet import Program, entitle, environment
from tests.support.site import Site

SIZES: Final = {"100": 8_000, "10000": 3_000, "1000000": 60, "image": 12}
IMAGE: Final = 6 * 1024 * 1024
LATENCY: Final = 50  # messages of a sample
TURNS: Final = {"1000000": 3, "image": 4, "latency": 4}  # in a round; others have one
FANOUT: Final = 300
MODES: Final = ("stock", "rossec", "stunnel", "node")
_PLANS: Final = (None, 2.0, 0.5)

_HEAD: Final = """
import json, sys, threading, time
if sys.argv[1] == "rossec":
    import rossec
    rossec.secure()
import rospy
from std_msgs.msg import String
from sensor_msgs.msg import Image
from geometry_msgs.msg import PoseStamped
TOPICS = {"text": String, "image": Image, "time": String, "pose": PoseStamped}
"""

PUBLISHER: Final = (
    _HEAD
    + """
import rospy.impl.tcpros_base as base
inner, outer = int(sys.argv[2]), int(sys.argv[3])
if outer:
    base.TCPServer.get_full_addr = lambda self: ("127.0.0.1", outer)
rospy.init_node("bench_publisher", tcpros_port=inner, disable_rosout=True)
made = {}
for name, kind in TOPICS.items():
    made[name] = rospy.Publisher("/bench/" + name, kind, queue_size=0)
print("READY", flush=True)
for line in sys.stdin:
    name, size, count = line.split()
    size, count, publisher = int(size), int(count), made[name]
    while publisher.get_num_connections() < (10 if name == "pose" else 1):
        time.sleep(0.01)
    message = TOPICS[name]()
    if name == "text":
        message.data = "x" * size
    elif name == "image":
        message.data = bytes(size)
    elif name == "pose":
        message.header.frame_id = "map"
        message.pose.position.x = 3.3
    begin = time.monotonic()
    for _ in range(count):
        if name == "time":
            message.data = str(time.monotonic_ns())
            publisher.publish(message)
            time.sleep(0.01)
        else:
            publisher.publish(message)
    print("BEGAN", begin, flush=True)
"""
)

SUBSCRIBER: Final = (
    _HEAD
    + """
rospy.init_node(sys.argv[2], disable_rosout=True)
wanted, seen, delays = 0, 0, []
changed = threading.Event()
def count(message):
    global seen
    seen += 1
    if seen == wanted:
        print("DONE", time.monotonic(), flush=True)
def clock(message):
    delays.append((time.monotonic_ns() - int(message.data)) / 1000)
    count(message)
for name in sys.argv[3:]:
    note = clock if name == "time" else count
    rospy.Subscriber("/bench/" + name, TOPICS[name], note, buff_size=1 << 20)
print("READY", flush=True)
for line in sys.stdin:
    if line.startswith("delays"):
        print("DELAYS", json.dumps(delays), flush=True)
        delays.clear()
    else:
        seen, wanted = 0, int(line)
        print("ARMED", flush=True)
"""
)

_NODE: Final = """
import asyncio, json, sys, time
import numpy
from rossec.node import Node
TOPICS = {"text": "std_msgs/String", "image": "sensor_msgs/Image", "time": "std_msgs/String"}
async def commands():
    lines = asyncio.StreamReader()
    protocol = asyncio.StreamReaderProtocol(lines)
    await asyncio.get_running_loop().connect_read_pipe(lambda: protocol, sys.stdin)
    print("READY", flush=True)
    while line := await lines.readline():
        yield line.decode()
"""

NODE_PUBLISHER: Final = (
    _NODE
    + """
async def main():
    async with Node("/node_publisher") as node:
        made = {}
        for name, kind in TOPICS.items():
            made[name] = await node.publisher("/node/" + name, kind, queue_size=10000)
        async for line in commands():
            name, size, count = line.split()
            publisher = made[name]
            await publisher.wait_for_subscribers()
            message = publisher.create()
            message.data = numpy.zeros(int(size), "uint8") if name == "image" else "x" * int(size)
            begin = time.monotonic()
            for number in range(int(count)):
                if name == "time":
                    message.data = str(time.monotonic_ns())
                publisher.publish(message)
                if name == "time":
                    await asyncio.sleep(0.01)
                elif number % 64 == 63:  # nothing is sent before the loop has a turn
                    await asyncio.sleep(0)
            print("BEGAN", begin, flush=True)
asyncio.run(main())
"""
)

NODE_SUBSCRIBER: Final = (
    _NODE
    + """
wanted, seen, delays = 0, 0, []
async def count(name, subscriber):
    global seen
    async for message in subscriber:
        if name == "time":
            delays.append((time.monotonic_ns() - int(message.data)) / 1000)
        seen += 1
        if seen == wanted:
            print("DONE", time.monotonic(), flush=True)
async def main():
    global wanted, seen
    async with Node("/node_subscriber") as node, asyncio.TaskGroup() as group:
        for name, kind in TOPICS.items():
            subscriber = await node.subscriber("/node/" + name, kind, queue_size=10000)
            group.create_task(count(name, subscriber))
        async for line in commands():
            if line.startswith("delays"):
                print("DELAYS", json.dumps(delays), flush=True)
                delays.clear()
            else:
                seen, wanted = 0, int(line)
                print("ARMED", flush=True)
asyncio.run(main())
"""
)


_COMMON: Final = """
foreground = yes
syslog = no
debug = err
sslVersion = TLSv1.3
socket = l:TCP_NODELAY=1
socket = r:TCP_NODELAY=1
"""


def _cpu(pid: int) -> float:
    return time.clock_gettime(~pid << 3 | 2)  # clock_getcpuclockid(3), which Python does not have


class Pair:
    """A publisher and its subscribers, of one kind."""

    def __init__(self, publisher: Program, subscribers: list[Program]) -> None:
        self.publisher = publisher
        self.subscribers = subscribers

    def cpu(self) -> float:
        """Seconds of processor time that all its programs have used."""
        return sum(_cpu(p.process.pid) for p in (self.publisher, *self.subscribers))

    async def burst(self, kind: str, size: int, count: int) -> float:
        """Seconds from the first message published to the last one received."""
        for subscriber in self.subscribers:
            await subscriber.tell(str(count))
            await subscriber.read_until("ARMED")
        await self.publisher.tell(f"{kind} {size} {count}")
        ends = [float((await s.read_until("DONE", 120)).split()[1]) for s in self.subscribers]
        begin = float((await self.publisher.read_until("BEGAN", 120)).split()[1])
        return max(ends) - begin

    async def delays(self) -> list[float]:
        """Microseconds of each message of a paced run."""
        await self.burst("time", 0, LATENCY)
        await self.subscribers[0].tell("delays")
        line = await self.subscribers[0].read_until("DELAYS")
        found: list[float] = json.loads(line.removeprefix("DELAYS "))
        return found


@contextlib.asynccontextmanager
async def talking(env: dict[str, str], source: str, *arguments: str) -> AsyncIterator[Program]:
    """A program that reads commands on its standard input."""
    process = await asyncio.create_subprocess_exec(
        *stock.python(source, *arguments),
        env=env,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        limit=1 << 20,
    )
    try:
        yield Program(process)
    finally:
        if process.returncode is None:
            process.kill()
        await process.communicate()


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port: int = free.getsockname()[1]
    return port


def _service(accept: int, connect: int) -> str:
    return f"[topics]\naccept = 127.0.0.1:{accept}\nconnect = 127.0.0.1:{connect}\n"


@contextlib.contextmanager
def tunnel(folder: Path, inner: int, outer: int) -> Any:
    """stunnel on both sides, as one would put it between two hosts: TLS 1.3, both authenticated."""
    folder.mkdir()
    certificates(folder)
    middle = _free_port()
    common = _COMMON
    verify = f"CAfile = {folder}/root.pem\nverifyChain = yes\n"
    sides = {"server": _service(middle, inner), "client": _service(outer, middle) + "client = yes\n"}
    running = []
    try:
        for side, service in sides.items():
            path = folder / f"{side}.conf"
            path.write_text(f"{common}{service}cert = {folder}/{side}.pem\n{verify}")
            (folder / f"{side}.pem").chmod(0o600)
            running.append(subprocess.Popen(["/usr/bin/stunnel4", path], stdin=subprocess.DEVNULL))
        yield
    finally:
        for process in running:
            process.kill()
            process.wait()


def _plan(step: float | None) -> Restriction | None:
    if step is None:
        return None
    rules = filter_rules({"pose.position": {"round": {"step": step}}, "header.frame_id": {"clear": True}})
    return Restriction(type="geometry_msgs/PoseStamped", filters=rules)


def _entitle(site: Site) -> None:
    entitle(site, "/bench_publisher", {Right.PUBLISH: ("/bench/*",)})
    entitle(site, "/bench_subscriber", {Right.SUBSCRIBE: ("/bench/*",)})
    entitle(site, "/node_publisher", {Right.PUBLISH: ("/node/*",)})
    entitle(site, "/node_subscriber", {Right.SUBSCRIBE: ("/node/*",)})
    for number in range(10):
        plan = _plan(_PLANS[number % len(_PLANS)])
        site.subscribe(f"/fan{number}", "/bench/pose", plan)


@contextlib.asynccontextmanager
async def pairs(folder: Path) -> AsyncIterator[tuple[dict[str, Pair], dict[str, Pair]]]:
    """The pairs for throughput and latency, and those with ten subscribers."""
    inner, outer = _free_port(), _free_port()
    async with contextlib.AsyncExitStack() as stack:
        uri = await stack.enter_async_context(stock.rosmaster(folder / "master"))
        site = await stack.enter_async_context(Site(folder / "site").running())
        tunnelled = await stack.enter_async_context(stock.rosmaster(folder / "tunnelled"))
        stack.enter_context(tunnel(folder / "tunnel", inner, outer))
        _entitle(site)
        env = {
            "stock": stock.environment(uri, folder / "logs"),
            "rossec": environment(site, folder / "logs"),
            "stunnel": stock.environment(tunnelled, folder / "logs"),
        }
        made, fans = {}, {}
        node = [
            await stack.enter_async_context(talking(env["rossec"], source))
            for source in (NODE_PUBLISHER, NODE_SUBSCRIBER)
        ]
        made["node"] = Pair(node[0], node[1:])
        for mode in MODES[:3]:
            ports = (str(inner), str(outer)) if mode == "stunnel" else ("0", "0")
            publisher = await stack.enter_async_context(talking(env[mode], PUBLISHER, mode, *ports))
            subscriber = await stack.enter_async_context(
                talking(env[mode], SUBSCRIBER, mode, "bench_subscriber", "text", "image", "time")
            )
            made[mode] = Pair(publisher, [subscriber])
            if mode != "stunnel":
                fan = [
                    await stack.enter_async_context(
                        talking(env[mode], SUBSCRIBER, mode, f"fan{number}", "pose")
                    )
                    for number in range(10)
                ]
                fans[mode] = Pair(publisher, fan)
        for pair in (*made.values(), *fans.values()):  # they all start at the same time
            for running in (pair.publisher, *pair.subscribers):
                if "READY" not in running.said:
                    await running.read_until("READY", within=120)
        yield made, fans


def _turns(what: str, modes: Sequence[str], rounds: int) -> Iterator[str]:
    """The order of the measurements."""
    for turn in range(rounds, rounds + TURNS.get(what, 1)):
        yield from modes if turn % 2 else reversed(modes)


async def _sample(folder: Path, seconds: float) -> dict[str, Any]:
    times: dict[tuple[str, str], list[float]] = defaultdict(list)
    delays: dict[str, list[float]] = defaultdict(list)
    work: dict[tuple[str, str], list[float]] = defaultdict(list)
    async with pairs(folder) as (made, fans):
        loop = asyncio.get_running_loop()
        end, rounds = loop.time() + seconds, 0
        while rounds < 3 or loop.time() < end:
            for size, count in SIZES.items():
                kind, length = ("image", IMAGE) if size == "image" else ("text", int(size))
                for mode in MODES if rounds == 0 else ():
                    await made[mode].burst(kind, length, max(1, count // 4))  # warm
                for mode in _turns(size, MODES, rounds):
                    before = made[mode].cpu()
                    times[size, mode].append(await made[mode].burst(kind, length, count))
                    work[size, mode].append(made[mode].cpu() - before)
            for mode in _turns("fanout", MODES[:2], rounds):
                before = fans[mode].cpu()
                times["fanout", mode].append(await fans[mode].burst("pose", 0, FANOUT))
                work["fanout", mode].append(fans[mode].cpu() - before)
            for mode in _turns("latency", ("stock", "rossec", "node"), rounds):
                delays[mode] += await made[mode].delays()
            rounds += 1
    return _figures(times, work, delays)


Samples = dict[tuple[str, str], list[float]]


def _figures(times: Samples, work: Samples, delays: dict[str, list[float]]) -> dict[str, Any]:
    def ratio(size: str, other: str, samples: Samples = times) -> float:
        pairs = zip(samples[size, other], samples[size, "rossec"], strict=True)
        return round(statistics.median(theirs / ours for theirs, ours in pairs), 3)

    def rate(size: str, mode: str) -> float:
        return round(SIZES[size] / statistics.median(times[size, mode]), 1)

    def percentile(mode: str, percent: int) -> float:
        return statistics.quantiles(delays[mode], n=100)[percent - 1]

    return {
        "throughput_vs_stock": {size: ratio(size, "stock") for size in SIZES},
        "throughput_vs_stunnel": {size: ratio(size, "stunnel") for size in SIZES},
        "fanout10_vs_stock": ratio("fanout", "stock"),
        "cpu_vs_stock": {size: ratio(size, "stock", work) for size in (*SIZES, "fanout")},
        "latency_added_us_p50": round(percentile("rossec", 50) - percentile("stock", 50), 1),
        "latency_added_us_p99": round(percentile("rossec", 99) - percentile("stock", 99), 1),
        "latency_stock_us_p50": round(percentile("stock", 50), 1),
        "node_latency_us_p50": round(percentile("node", 50), 1),
        "node_vs_inprocess": {size: ratio(size, "node") for size in SIZES},
        "node_cpu_vs_inprocess": {size: ratio(size, "node", work) for size in SIZES},
        "messages_per_second": {mode: {size: rate(size, mode) for size in SIZES} for mode in MODES},
        "rounds": len(times["fanout", "stock"]),
    }


def measure(seconds: float) -> dict[str, Any]:
    """All figures."""
    with tempfile.TemporaryDirectory() as folder:
        for name in ("master", "tunnelled", "logs"):
            (Path(folder) / name).mkdir()
        return asyncio.run(_sample(Path(folder), seconds))
