"""`docs/howto/thirty-robots.md`, typed as printed: an empty home, thirty joins, a rule changed.

The four blocks run in one shell at a terminal, where a person answers the prompts. What is added:
it waits for the service and the master, and looks at what flows.
"""

import itertools
import re
import subprocess
import sys
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import BIN, ROOT, SECRET
from tests.support.ports import free_port

TEXT: Final = (ROOT / "docs" / "howto" / "thirty-robots.md").read_text()
BACKGROUND: Final = re.compile(r"(?m)^(rossec (?:ca serve|master)) .*&.*$")
CUT: Final = 1.0  # seconds


def block(name: str) -> str:
    """One block of commands as printed."""
    _, found, rest = TEXT.partition(f"<!-- {name} -->\n```\n")
    assert found
    return rest.partition("```")[0]


def test_a_site_of_thirty_takes_eight_commands_and_one_passphrase() -> None:
    printed = "".join(map(block, ("site", "robots", "run", "change")))
    typed = [line for line in printed.splitlines() if re.match(r"rossec |\w+=\S+ rossec ", line)]
    loop = [line for line in printed.splitlines() if re.match(r"    \w+=\S+ rossec ", line)]
    shown = [line for line in typed if " topic " in line]  # a robot's work, not the operator's
    assert len(loop) == 1
    assert len(typed) - len(shown) <= 8
    assert printed.count("asks for") == 2


@pytest.fixture
def script(tmp_path: Path) -> str:
    waits = {
        "rossec ca serve": "until rossec ca status >/dev/null 2>&1; do sleep 0.1; done",
        "rossec master": "until (: >/dev/tcp/127.0.0.1/$PORT) 2>/dev/null; do sleep 0.1; done",
    }
    serve = f"rossec ca serve --join-address 127.0.0.1:{free_port()}"  # tests run side by side
    site = BACKGROUND.sub(lambda found: f"{found[0]}\n{waits[found[1]]}", block("site"))
    site = site.replace("rossec ca serve", serve, 1)
    return "\n".join(
        (
            "set -e",
            "trap 'kill $(jobs -p) 2>/dev/null || true' EXIT",
            f"cd {tmp_path}",
            site,
            block("robots"),
            block("run"),
            FLOWS,
            block("change"),
            AFTER,
        )
    )


POSES: Final = ("r01", "r02")
CAMERAS: Final = ("r03", "r04")
FLOWS: Final = f"""
as() {{ ROSSEC_HOME=~/hosts/$1 "${{@:2}}"; }}
publish() {{ as robots/$1 rossec topic pub /site/robots/$1/$2 std_msgs/String \\
    --as /site/robots/$1 --rate 20 'data: x'; }}
for robot in {" ".join(POSES)}; do publish $robot pose & done
for robot in {" ".join(CAMERAS)}; do publish $robot camera & done
as guest rossec topic echo /site/robots/r01/pose std_msgs/String --as /site/guest > guest 2>&1 &
as station {sys.executable} station.py &
until [ -e receiving ]; do sleep 0.1; done
"""
STATION: Final = f"""
import asyncio, pathlib, time
from rossec.node import Node

TOPICS = [*(f"/site/robots/{{r}}/pose" for r in {POSES}),
          *(f"/site/robots/{{r}}/camera" for r in {CAMERAS})]
received = {{topic: [] for topic in TOPICS}}

async def receive(node, topic):
    async for _ in await node.subscriber(topic, "std_msgs/String"):
        received[topic].append(time.time())

async def main():
    async with Node("/site/station") as node:
        tasks = [asyncio.create_task(receive(node, topic)) for topic in TOPICS]
        while not all(received.values()):
            await asyncio.sleep(0.1)
        pathlib.Path("receiving").touch()
        while not pathlib.Path("over").exists():
            await asyncio.sleep(0.1)
    lines = (f"{{topic}} {{' '.join(map(str, times))}}" for topic, times in received.items())
    pathlib.Path("received.part").write_text("\\n".join(lines))
    pathlib.Path("received.part").rename("received")

asyncio.run(main())
"""
AFTER: Final = """
date +%s.%N > applied
sleep 3
date +%s.%N > end
touch over
until [ -e received ]; do sleep 0.1; done
"""


def test_the_howto_works_as_printed(tmp_path: Path, script: str) -> None:
    port = free_port()
    (tmp_path / "howto.sh").write_text(script)
    (tmp_path / "station.py").write_text(STATION)
    env = {
        "HOME": str(tmp_path),
        "PATH": f"{BIN}:/usr/bin:/bin",
        "PORT": str(port),
        "TERM": "dumb",
        "ROS_MASTER_URI": f"http://127.0.0.1:{port}/",
    }
    typed = [sys.executable, "-m", "tests.support.terminal", SECRET, SECRET, SECRET, "--"]
    done = subprocess.run(
        [*typed, "/bin/bash", str(tmp_path / "howto.sh")],
        env=env,
        cwd=ROOT,
        text=True,
        capture_output=True,
        timeout=110,
        check=False,
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    assert "Traceback" not in said
    applied, end = (float((tmp_path / name).read_text()) for name in ("applied", "end"))
    for line in (tmp_path / "received").read_text().splitlines():
        topic, *times = line.split()
        last, gaps = float(times[-1]), longest_gap([*map(float, times)], applied - 2)
        if topic.endswith("/camera"):
            assert last < applied + CUT, f"{topic} was cut {last - applied:.1f} s later"
        else:
            assert end - last < 1, f"{topic} ended {end - last:.1f} s before the end"
            assert gaps < 1, f"{topic} paused for {gaps:.1f} s"
    guest = (tmp_path / "guest").read_text()
    assert "needs the right subscribe" in guest
    assert "data" not in guest


def longest_gap(times: list[float], begin: float) -> float:
    """Seconds between two messages, since `begin`."""
    later = [at for at in times if at >= begin]
    return max(after - before for before, after in itertools.pairwise(later))
