"""A publishing and a subscribing program in each of the three forms; all forms behave alike.

The rospy sources are used twice: in-process with two more lines, and unmodified behind a sidecar.

A publisher KIND publishes /KIND/words and /KIND/brief (strings that count), /KIND/latched (one
string) and /KIND/pose (every second one in a frame that no grant allows), and provides
/KIND/switch; between messages it waits the seconds it is told, or 0.1. A subscriber subscribes to
those of all kinds and calls them in a loop, over a connection for each call (CALLED) and over a
persistent one (KEPT); it subscribes to /KIND/brief once the given file exists.
"""

from collections.abc import Mapping, Sequence
from typing import Final

from tests.support.fleet import SECURE

KINDS: Final = ("inprocess", "builtin", "sidecar")
SEEN: Final = "4.0 0.0 ''"
"""What `tests.support.site.coarse` leaves of the poses in the frame of the map."""

_ROSPY_SPEAKER: Final = """
import sys, time, rospy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolResponse
kind, pause = sys.argv[1], float((*sys.argv, 0.1)[2])
rospy.init_node(f"{kind}_speaker")
words = rospy.Publisher(f"/{kind}/words", String, queue_size=10)
brief = rospy.Publisher(f"/{kind}/brief", String, queue_size=10)
poses = rospy.Publisher(f"/{kind}/pose", PoseStamped, queue_size=10)
rospy.Publisher(f"/{kind}/latched", String, queue_size=1, latch=True).publish(f"{kind} kept")
rospy.Service(
    f"/{kind}/switch", SetBool, lambda asked: SetBoolResponse(asked.data, f"{kind} answers")
)
print("READY", flush=True)
number, known = 0, None
while not rospy.is_shutdown():
    words.publish(f"{kind} {number}")
    brief.publish(f"{kind} {number}")
    pose = PoseStamped()
    pose.header.frame_id = ("map", "secret")[number % 2]
    pose.pose.position.x, pose.pose.position.y = 3.3, 100.0 * (number % 2)
    poses.publish(pose)
    count = words.get_num_connections(), brief.get_num_connections()
    if count != known:
        print("LISTENERS words %d brief %d" % count, flush=True)
    number, known = number + 1, count
    time.sleep(pause)
"""

_ROSPY_LISTENER: Final = """
import os, sys, time, rospy
from geometry_msgs.msg import PoseStamped
from std_msgs.msg import String
from std_srvs.srv import SetBool
kind, kinds, signal = sys.argv[1], sys.argv[2].split(), sys.argv[3]
rospy.init_node(f"{kind}_listener")
def say(*words):
    sys.stdout.write(" ".join(words) + "\\n")  # at once: several threads speak
    sys.stdout.flush()
def word(message, about):
    say("HEARD", about, message.data)
def pose(message, about):
    at = message.pose.position
    say("HEARD", about, f"{at.x} {at.y} {message.header.frame_id!r}")
for other in kinds:
    for topic, form, hear in (("words", String, word), ("latched", String, word),
                              ("pose", PoseStamped, pose)):
        rospy.Subscriber(f"/{other}/{topic}", form, hear, f"{other} {topic}")
for other in kinds:
    rospy.wait_for_service(f"/{other}/switch", timeout=30)
kept, followed = {}, False
def call(about, other, proxy):
    try:
        say(about, other, proxy(True).message)
        return proxy
    except rospy.ServiceException as error:
        say("NOT", about, other, str(error).replace(chr(10), " "))
        proxy.close()
while not rospy.is_shutdown():
    for other in kinds:
        name = f"/{other}/switch"
        call("CALLED", other, rospy.ServiceProxy(name, SetBool))
        proxy = kept.get(other) or rospy.ServiceProxy(name, SetBool, persistent=True)
        kept[other] = call("KEPT", other, proxy)
    time.sleep(0.5)
    if not followed and os.path.exists(signal):
        followed = True
        for other in kinds:
            rospy.Subscriber(f"/{other}/brief", String, word, f"{other} brief")
"""

_BUILTIN_SPEAKER: Final = """
import asyncio, sys
from rossec.node import Node
async def main(kind, pause):
    async with Node(f"/{kind}_speaker") as node:
        words = await node.publisher(f"/{kind}/words", "std_msgs/String")
        brief = await node.publisher(f"/{kind}/brief", "std_msgs/String")
        poses = await node.publisher(f"/{kind}/pose", "geometry_msgs/PoseStamped")
        latched = await node.publisher(f"/{kind}/latched", "std_msgs/String", latch=True)
        latched.publish(latched.create(data=f"{kind} kept"))
        await node.service(
            f"/{kind}/switch", "std_srvs/SetBool",
            lambda asked: {"success": asked.data, "message": f"{kind} answers"},
        )
        print("READY", flush=True)
        number, known = 0, None
        while True:
            words.publish(words.create(data=f"{kind} {number}"))
            brief.publish(brief.create(data=f"{kind} {number}"))
            pose = poses.create()
            pose.header.frame_id = ("map", "secret")[number % 2]
            pose.pose.position.x, pose.pose.position.y = 3.3, 100.0 * (number % 2)
            poses.publish(pose)
            count = len(words.links), len(brief.links)
            if count != known:
                print("LISTENERS words %d brief %d" % count, flush=True)
            number, known = number + 1, count
            await asyncio.sleep(pause)
asyncio.run(main(sys.argv[1], float((*sys.argv, 0.1)[2])))
"""

_BUILTIN_LISTENER: Final = """
import asyncio, os, sys
from ca.errors import HintedError
from rossec.node import Node
async def word(subscriber, about):
    async for message in subscriber:
        print(f"HEARD {about} {message.data}", flush=True)
async def pose(subscriber, about):
    async for message in subscriber:
        at = message.pose.position
        print(f"HEARD {about} {at.x} {at.y} {message.header.frame_id!r}", flush=True)
async def call(about, other, client):
    try:
        print(about, other, (await client(data=True)).message, flush=True)
    except HintedError as error:
        print("NOT", about, other, error, flush=True)
async def main(kind, kinds, signal):
    async with Node(f"/{kind}_listener") as node, asyncio.TaskGroup() as group:
        async def follow(other, topic, form, hear):
            subscriber = await node.subscriber(f"/{other}/{topic}", form, queue_size=2000)
            group.create_task(hear(subscriber, f"{other} {topic}"))
        for other in kinds:
            await follow(other, "words", "std_msgs/String", word)
            await follow(other, "latched", "std_msgs/String", word)
            await follow(other, "pose", "geometry_msgs/PoseStamped", pose)
        clients = {}
        for other in kinds:
            name = f"/{other}/switch"
            await node.wait_for_service(name, timeout=30)
            clients[other] = [
                node.client(name, "std_srvs/SetBool", persistent=kept) for kept in (False, True)
            ]
        followed = False
        while True:
            for other, (single, kept) in clients.items():
                await call("CALLED", other, single)
                await call("KEPT", other, kept)
            await asyncio.sleep(0.5)
            if not followed and os.path.exists(signal):
                followed = True
                for other in kinds:
                    await follow(other, "brief", "std_msgs/String", word)
asyncio.run(main(sys.argv[1], sys.argv[2].split(), sys.argv[3]))
"""

SPEAKERS: Final[Mapping[str, str]] = {
    "inprocess": SECURE + _ROSPY_SPEAKER,
    "builtin": _BUILTIN_SPEAKER,
    "sidecar": _ROSPY_SPEAKER,
}
LISTENERS: Final[Mapping[str, str]] = {
    "inprocess": SECURE + _ROSPY_LISTENER,
    "builtin": _BUILTIN_LISTENER,
    "sidecar": _ROSPY_LISTENER,
}


def command(kind: str, python: str, rossec: str, source: str, *more: str) -> Sequence[str]:
    """The command that starts a program of this kind."""
    plain = (python, "-c", source, kind, *more)
    return (rossec, "run", "--", *plain) if kind == "sidecar" else plain
