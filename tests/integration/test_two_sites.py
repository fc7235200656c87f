"""`docs/howto/two-sites.md`, typed as printed: homes behind NAT, routers in the open, all recorded.

The second test types it with links in clear, so that what is recorded is what a router sees: TLS
between relays and routers would hide that from the recording, and from nobody else.
"""

import asyncio
import itertools
import json
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.test_first_steps import ROOT
from tests.support.recorder import Recording
from tests.support.stock import TOOLS, environment, process, python
from tests.support.typed import TypedShell, blocks_of, shells_of
from tests.support.wan import Wan, wan_of

PAGE: Final = ROOT / "docs" / "howto" / "two-sites.md"
SITES: Final = {"ada": ("ada", "kitchen"), "ben": ("ben",), "cottage": ("cottage",)}
ROUTERS: Final = ("router", "second")
CLEAR: Final = """
rossec router --listen tcp/[::]:7447 &
rossec router accounts show s1 > ~/stick/s1.account
rossec router accounts show s2 > ~/stick/s2.account
"""
LISTEN: Final = """
rossec topic echo ada:/robot/pose geometry_msgs/PoseStamped --as /tablet > heard 2> complaints &
until grep -q "x: 3.0" heard; do sleep 0.1; done
cp complaints before
"""
HEAR_MORE: Final = """
until rossec federation status | grep "tls/203.0.113.10:7447, linked"; do sleep 0.2; done
heard=$(grep -c "x: 3.0" heard)
until test $(grep -c "x: 3.0" heard) -gt $heard; do sleep 0.1; done
cmp complaints before
"""
PLAIN: Final = (b"/robot/pose", b"/tablet", b"PoseStamped", b"front door")
NAMES: Final = (
    *PLAIN,
    b"/robot/camera",
    b"/cottage",
    b"/kitchen",
    b"/relay",
    b"/master",
    b"PoseStamped",
    b"std_msgs",
    b"home-of-ada",
    b"home-of-ben",
    b"front door",
    b"still warm",
)


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


@pytest.mark.timeout(400)
async def test_two_sites_work_as_printed(wan: Wan, shells: dict[str, TypedShell], tmp_path: Path) -> None:
    """Then a home's line is cut, and the router in use is killed: no connection of a node ends."""
    async with wan.recorded(tmp_path / "capture") as found:
        for block in blocks_of(PAGE):
            shells[block.host].type(block.commands)
        assert "tls/203.0.113.11:7447, linked" in shells["ben"].said
        shells["ben"].type(LISTEN)
        with wan.without("ben"):
            await asyncio.sleep(5)
        shells["second"].type('kill -9 "%rossec router"')
        with wan.lossy(one_of=50):
            shells["ben"].type(HEAR_MORE)
    assert shells["ben"].said.count("x: 3.0") == 2
    assert shells["kitchen"].said.count('data: "still warm"') == 2
    said = "".join(shell.said for shell in shells.values())
    assert "Traceback" not in said
    assert "x: 3.3" not in said
    assert seen(found[0], NAMES) == []


@pytest.mark.timeout(300)
async def test_routers_learn_nothing_of_two_sites(
    wan: Wan, shells: dict[str, TypedShell], short_path: Path, tmp_path: Path
) -> None:
    """Inboxes are what a router sees, and so does the recording; its log has not even those."""
    async with wan.recorded(tmp_path / "capture") as found:
        for block in itertools.takewhile(lambda block: block.host != "cottage", blocks_of(PAGE)):
            if block.host != "second":  # routers with accounts join each other with TLS only
                shells[block.host].type(block.commands.replace("rossec router &", CLEAR))
    assert shells["ben"].said.count("x: 3.0") == 2
    assert "tcp/203.0.113.10:7447, linked" in shells["ben"].said
    descriptors = [short_path / "stick" / f"relay-for-{name}.descriptor" for name in ("ada", "ben")]
    inboxes = [json.loads(descriptor.read_bytes())["inbox"].encode() for descriptor in descriptors]
    assert seen(found[0], inboxes) == inboxes
    assert seen(found[0], NAMES) == []
    assert [name for name in NAMES if name.decode() in shells["router"].said] == []
    assert "rossec/1/" not in shells["router"].said


def seen(recording: Recording, names: Iterable[bytes]) -> list[bytes]:
    """Which of the names went through a router's link."""
    assert recording.dropped == 0
    return [name for name in names if recording.holds(name)]


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
    assert seen(found[0], PLAIN) == list(PLAIN)


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
