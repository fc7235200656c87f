"""`docs/howto/two-sites.md`, typed as printed: homes behind NAT, routers in the open, all recorded.

The second test types it with links in clear, which shows what a router sees: TLS between relays and
routers hides from the network what is hidden from the routers too.
"""

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.stock import TOOLS, environment, process, python
from tests.support.typed import TypedShell, blocks_of, shells_of
from tests.support.wan import Wan, wan_of

PAGE: Final = ROOT / "docs" / "howto" / "two-sites.md"
SITES: Final = {"ada": ("ada", "kitchen"), "ben": ("ben",), "cottage": ("cottage",)}
ROUTERS: Final = ("router", "second")
PLAIN: Final = (b"/robot/pose", b"/tablet", b"PoseStamped", b"front door")
NAMES: Final = (
    *PLAIN, b"/robot/camera", b"/cottage", b"/kitchen", b"/relay",
    b"/master", b"PoseStamped", b"std_msgs", b"home-of-ada", b"home-of-ben",
    b"front door", b"still warm",
)  # fmt: skip


@pytest.fixture
def wan() -> Iterator[Wan]:
    with wan_of(SITES, ROUTERS, delay_ms=5) as network:
        yield network


@pytest.fixture
def shells(wan: Wan, short_path: Path) -> Iterator[dict[str, TypedShell]]:
    opened = shells_of(wan.hosts, short_path)
    try:
        yield opened
    finally:
        for shell in opened.values():
            shell.close()


async def test_two_sites_work_as_printed(
    wan: Wan, shells: dict[str, TypedShell], tmp_path: Path
) -> None:
    async with wan.recorded(tmp_path / "capture") as found:
        for block in blocks_of(PAGE):
            shells[block.host].type(block.commands)
    (recording,) = found
    assert recording.dropped == 0
    assert shells["ben"].said.count("x: 3.0") == 2
    assert shells["kitchen"].said.count("data: still warm") == 2
    said = "".join(shell.said for shell in shells.values())
    assert "Traceback" not in said
    assert "x: 3.3" not in said
    assert [name for name in NAMES if recording.holds(name)] == []


@pytest.mark.ros
async def test_the_same_in_plain_ros_is_seen_by_routers(wan: Wan, tmp_path: Path) -> None:
    """The control of the tests above: what they do not find, the recording shows where it is."""
    uri = f"http://{wan['second'].ipv4}:11311/"

    def plain(host: str) -> dict[str, str]:
        return {**environment(uri, tmp_path), "ROS_IP": wan[host].ipv4}

    robot, tablet = wan["second"].at(*python(ROBOT)), wan["ben"].at(*python(TABLET))
    master = wan["second"].at(str(TOOLS / "rosmaster"), "--core", "-p", "11311")
    async with (
        wan.recorded(tmp_path / "capture") as found,
        process(plain("second"), *master),
        process(plain("second"), *robot) as sender,
        asyncio.timeout(30),
    ):
        assert sender.stdout is not None
        assert await sender.stdout.readline()  # behind NAT nobody is told of a publisher later
        async with process(plain("ben"), *tablet) as receiver:
            said, _ = await receiver.communicate()
    assert b"front door" in said
    assert [name for name in PLAIN if not found[0].holds(name)] == []


ROBOT: Final = """
import rospy
from geometry_msgs.msg import PoseStamped
rospy.init_node("robot")
publisher = rospy.Publisher("/robot/pose", PoseStamped, queue_size=1, latch=True)
message = PoseStamped()
message.header.frame_id = "front door"
publisher.publish(message)
print("published", flush=True)
rospy.spin()
"""
TABLET: Final = """
import rospy
from geometry_msgs.msg import PoseStamped
rospy.init_node("tablet")
print(rospy.wait_for_message("/robot/pose", PoseStamped), flush=True)
"""
