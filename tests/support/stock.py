"""Programs of stock ROS 1 as separate processes: rosmaster, rospy nodes, command line tools."""

import asyncio
import contextlib
import os
import socket
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

from tests.support.ports import free_port
from tests.support.witness import until

TOOLS: Final = Path("/usr/bin")
LISTENER: Final = """
import rospy, sys
from geometry_msgs.msg import PoseStamped
rospy.init_node("stock_listener")
rospy.Subscriber(sys.argv[1], PoseStamped, lambda message: print("RECEIVED", message, flush=True))
rospy.spin()
"""
NODE: Final = """
import rospy
from std_msgs.msg import String
rospy.init_node("stock_node")
rospy.Publisher("/stock", String, queue_size=1)
rospy.signal_shutdown("done")
"""


def environment(master_uri: str, directory: Path) -> dict[str, str]:
    return {
        **{key: value for key, value in os.environ.items() if not key.startswith("ROS")},
        "ROS_MASTER_URI": master_uri,
        "ROS_IP": "127.0.0.1",
        "ROS_HOME": str(directory),
        "ROS_LOG_DIR": str(directory),
        "PYTHONUNBUFFERED": "1",
    }


async def run(env: dict[str, str], *command: str) -> tuple[int | None, str]:
    """Run it until it exits; its exit code and output."""
    async with process(env, *command) as running:
        async with asyncio.timeout(30):
            said, _ = await running.communicate()
        return running.returncode, said.decode()


async def logged(directory: Path, words: str) -> str:
    """The first line with `words` in the log files that rospy writes into `directory`."""

    def find() -> list[str]:
        lines = (line for log in directory.rglob("*.log") for line in log.read_text().splitlines())
        return [line for line in lines if words in line]

    await until(find, within=30)
    return find()[0]


def python(source: str, *arguments: str) -> tuple[str, ...]:
    """A command line for a Python that sees Debian's rospy."""
    return (sys.executable, "-c", source, *arguments)


@contextlib.asynccontextmanager
async def process(env: dict[str, str], *command: str) -> AsyncIterator[asyncio.subprocess.Process]:
    """A running process; stdout and stderr are merged."""
    running = await asyncio.create_subprocess_exec(
        *command,
        env=env,
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        yield running
    finally:
        if running.returncode is None:
            running.kill()
        await running.communicate()


@contextlib.asynccontextmanager
async def rosmaster(directory: Path) -> AsyncIterator[str]:
    """Debian's rosmaster on a free port; its URI."""
    port = free_port()
    uri = f"http://127.0.0.1:{port}/"
    env = environment(uri, directory)
    async with process(env, str(TOOLS / "rosmaster"), "--core", "-p", str(port)):
        await until(lambda: _answers(port), within=30)
        yield uri


def _answers(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0
