"""What a subscriber's options cost, with publishers of every form, and what deflating saves.

Real processes on loopback. A publisher sends a message as soon as the last one has arrived, to one
subscriber at a time: built-in, without options or with one of them. A round has every option in turn,
so that other load hits all alike; `added_us` is the median of the differences to no option in the
same round. No message is thinned out or replaced: the rate is 10,000, and nothing waits.
`added_cpu_us` is processor time of publisher and subscriber for a message; of a publisher behind a
sidecar that of the sidecar alone. `bytes` is what a deflated message has left.
"""

import asyncio
import contextlib
import os
import signal
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import AsyncIterator
from pathlib import Path
from statistics import median
from typing import Any, Final

from grants.model import Right
from rossec.host.callers import descendants, parents
from rossec.node import Node
from rossec.participant.delivery_options import deflated
from rossec.participant.message_types import message_type
from tests.integration.sidecarworld import ROSSEC
from tests.support.fleet import SECURE, Program, entitle, environment
from tests.support.kinds import KINDS, command
from tests.support.site import Site
from tests.support.witness import until

OPTIONS: Final[dict[str, dict[str, Any]]] = {
    "none": {},
    "rate": {"rate": 10_000},
    "newest": {"newest": True},
    "deflate": {"deflate": True},
}
SIZES: Final = {"100 B": 100, "10 kB": 10_000, "1 MB": 1_000_000}
MESSAGES: Final = {"100 B": 200, "10 kB": 200, "1 MB": 20}  # of a turn
_PAUSE: Final = 0.0005  # seconds between messages: below the rate that is requested
TYPE: Final = "std_msgs/String"
_WORDS: Final = "battery 0.87 at x 1.25 y 3.75 in living_room; "  # deflates as state and logs do

_ROSPY: Final = """
import sys, rospy
from std_msgs.msg import String
kind = sys.argv[1]
rospy.init_node(f"{kind}_bench", disable_rosout=True)
topic = rospy.Publisher(f"/{kind}/bench", String, queue_size=10)
print("READY", flush=True)
for line in sys.stdin:
    size = int(line)
    topic.publish((WORDS * (size // len(WORDS) + 1))[:size])
""".replace("WORDS", repr(_WORDS))
_BUILTIN: Final = """
import asyncio, sys
from rossec.node import Node
async def main(kind):
    loop, reader = asyncio.get_running_loop(), asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    async with Node(f"/{kind}_bench") as node:
        topic = await node.publisher(f"/{kind}/bench", "std_msgs/String")
        print("READY", flush=True)
        while line := (await reader.readline()).decode():
            size = int(line)
            topic.publish(topic.create(data=(WORDS * (size // len(WORDS) + 1))[:size]))
asyncio.run(main(sys.argv[1]))
""".replace("WORDS", repr(_WORDS))
PUBLISHERS: Final = {"inprocess": SECURE + _ROSPY, "builtin": _BUILTIN, "sidecar": _ROSPY}


def _cpu(pid: int) -> float:
    return time.clock_gettime(~pid << 3 | 2)  # clock_getcpuclockid(3), which Python does not have


@contextlib.asynccontextmanager
async def _publishers(site: Site, logs: Path) -> AsyncIterator[dict[str, Program]]:
    found: dict[str, Program] = {}
    async with contextlib.AsyncExitStack() as stack:
        for kind in KINDS:
            entitle(site, f"/{kind}_bench", {Right.PUBLISH: (f"/{kind}/*",)})
            line = command(kind, sys.executable, ROSSEC, PUBLISHERS[kind])
            process = await asyncio.create_subprocess_exec(
                *line,
                env=environment(site, logs),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
            )
            stack.push_async_callback(_end, process)
            found[kind] = Program(process)
        for program in found.values():
            await program.read_until("READY", within=60)
        yield found


async def _end(process: asyncio.subprocess.Process) -> None:
    for pid in (process.pid, *descendants(parents(), process.pid)):
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    await process.communicate()


async def _turn(node: Node, kind: str, program: Program, size: str, option: str) -> tuple[float, float]:
    """Seconds for each message until it has arrived, and of processors for it."""
    subscriber = await node.subscriber(f"/{kind}/bench", TYPE, **OPTIONS[option])
    arrived = subscriber.raw()

    async def one() -> float:
        await asyncio.sleep(_PAUSE)
        begin = time.monotonic()
        await program.tell(str(SIZES[size]))
        await anext(arrived)
        return time.monotonic() - begin

    try:
        await until(lambda: subscriber.links)
        await asyncio.sleep(0.1)  # the publisher has it a moment later
        for _ in range(5):
            await one()
        count = MESSAGES[size]
        used = _cpu(program.process.pid) + time.process_time()
        took = [await one() for _ in range(count)]
        spent = _cpu(program.process.pid) + time.process_time() - used
        return median(took), spent / count
    finally:
        await subscriber.close()


async def _sample(folder: Path, seconds: float) -> dict[str, Any]:
    times: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    work: dict[tuple[str, str, str], list[float]] = defaultdict(list)
    async with Site(folder / "site").running() as site, _publishers(site, folder) as publishers:
        site.subscribe("/listener", "/*/bench")
        async with site.node("/listener") as node:
            end, rounds = time.monotonic() + seconds, 0
            while rounds < 3 or time.monotonic() < end:
                options = list(OPTIONS) if rounds % 2 else list(reversed(OPTIONS))
                for kind, program in publishers.items():
                    for size in SIZES:
                        for option in options:
                            took, used = await _turn(node, kind, program, size, option)
                            times[kind, size, option].append(took)
                            work[kind, size, option].append(used)
                rounds += 1
    return {
        "us_without_options": _table(times, "none"),
        "added_us": {option: _added(times, option) for option in OPTIONS if option != "none"},
        "added_cpu_us": {option: _added(work, option) for option in OPTIONS if option != "none"},
        "bytes": {size: _left(count) for size, count in SIZES.items()},
        "rounds": rounds,
    }


Samples = dict[tuple[str, str, str], list[float]]


def _table(samples: Samples, option: str) -> dict[str, dict[str, float]]:
    return {
        kind: {size: round(median(samples[kind, size, option]) * 1e6, 1) for size in SIZES} for kind in KINDS
    }


def _added(samples: Samples, option: str) -> dict[str, dict[str, float]]:
    def added(kind: str, size: str) -> float:
        pairs = zip(samples[kind, size, option], samples[kind, size, "none"], strict=True)
        return round(median(one - other for one, other in pairs) * 1e6, 1)

    return {kind: {size: added(kind, size) for size in SIZES} for kind in KINDS}


def _left(size: int) -> int:
    kind = message_type(TYPE)
    text = (_WORDS * (size // len(_WORDS) + 1))[:size]
    return len(deflated([kind.serialize(kind.create(data=text))]))


def measure(seconds: float) -> dict[str, Any]:
    """All figures."""
    with tempfile.TemporaryDirectory() as folder:
        return asyncio.run(_sample(Path(folder), seconds))
