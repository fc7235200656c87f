"""Two secured rospy programs that use all features of rospy, under every kind of name.

`python -m tests.support.matrix DIRECTORY HOST` runs them with a master on HOST, one variant of
names after the other, and prints what the client received. A separate program can be recorded.
"""

import asyncio
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from grants.model import Right
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.site import Site

SECRET: Final = "strictly-between-these-two-nodes"
COUNT: Final = 40

SERVER: Final = (
    SECURE
    + f"""
import time, rospy
from std_msgs.msg import String
from rosgraph_msgs.msg import Clock
from std_srvs.srv import SetBool, SetBoolResponse
rospy.init_node("server")
rospy.set_param("shared/colour", "{SECRET}")
rospy.set_param("/use_sim_time", True)
latched = rospy.Publisher("latched", String, latch=True, queue_size=1)
latched.publish("{SECRET} latched")
numbers = rospy.Publisher("numbers", String, queue_size=1000, tcp_nodelay=True)
direct = rospy.Publisher("direct", String, queue_size=None)
clock = rospy.Publisher("/clock", Clock, queue_size=10)
asked = []
def switch(request):
    asked.append(request)
    return SetBoolResponse(request.data, "{SECRET} %d" % len(asked))
rospy.Service("switch", SetBool, switch)
print("SERVING", rospy.get_name(), flush=True)
for step in range(100000):
    if rospy.is_shutdown():
        break
    clock.publish(rospy.Time(1000 + step // 100, step % 100 * 10000000))
    if numbers.get_num_connections():
        numbers.publish("{SECRET} %d" % step)
        direct.publish("{SECRET} %d" % step)
    time.sleep(0.005)
"""
)

CLIENT: Final = (
    SECURE
    + f"""
import rospy
from std_msgs.msg import String
from std_srvs.srv import SetBool
rospy.init_node("client")
def show(what, value):
    print("SEEN", what, value, flush=True)
message = rospy.wait_for_message("latched", String, timeout=20)
show("latched", message.data)
show("caller", message._connection_header["callerid"])
show("header", "rossec_grants" in message._connection_header)
rospy.wait_for_service("switch", timeout=20)
call = rospy.ServiceProxy("switch", SetBool)
show("call", call(True).message)
kept = rospy.ServiceProxy("switch", SetBool, persistent=True)
show("persistent", [kept(False).message for _ in range(3)])
show("parameter", rospy.get_param("shared/colour"))
show("cached", rospy.get_param_cached("shared/colour"))
show("search", rospy.search_param("shared"))
show("has", [rospy.has_param("shared/colour"), rospy.has_param("shared/none")])
rospy.set_param("~mine", {{"deep": [1, 2.5, True, "x"]}})
show("tree", rospy.get_param("~mine"))
rospy.delete_param("~mine")
show("deleted", rospy.get_param("~mine", "gone"))
show("private", rospy.get_param("~volume", "unset"))
numbers, directs, ticks = [], [], []
def keep(message, kept):
    kept.append(int(message.data.split()[-1]))
rospy.Subscriber("numbers", String, keep, numbers, tcp_nodelay=True)
rospy.Subscriber("direct", String, keep, directs)
timer = rospy.Timer(rospy.Duration(0.02), lambda event: ticks.append(event.current_real.to_sec()))
while min(len(numbers), len(directs)) < {COUNT} or len(ticks) < 5:
    rospy.sleep(0.01)
timer.shutdown()
show("ordered", all(b == a + 1 for some in (numbers, directs) for a, b in zip(some, some[1:])))
show("simtime", 1000 <= rospy.get_time() < 2000 and all(1000 <= t < 2000 for t in ticks))
show("name", rospy.get_name())
print("DONE", flush=True)
"""
)


class Variant:
    """How the two programs are named, and how their names are resolved."""

    def __init__(self, space: str, server: str, client: str, *remappings: str) -> None:
        self.space = space
        self.names = {"server": space + server, "client": space + client}
        self.remappings = remappings

    def arguments(self, role: str) -> list[str]:
        given = [f"__name:={self.names[role].rpartition('/')[2]}", *self.remappings]
        return [*given, f"__ns:={self.space}"] if self.space != "/" else given

    def resolve(self, name: str) -> str:
        """The resolved name of `name`."""
        changed = dict(item.split(":=") for item in self.remappings).get(name, name)
        return changed if changed.startswith("/") else self.space + changed


VARIANTS: Final[Mapping[str, Variant]] = {
    "as written": Variant("/", "server", "client"),
    "remapped": Variant(
        "/",
        "other_server",
        "other_client",
        "numbers:=/far/numbers",
        "switch:=/far/switch",
        "latched:=/far/latched",
    ),
    "namespaced": Variant("/robot1/", "server", "client"),
}


def entitle_both(site: Site, variant: Variant) -> None:
    """Exactly the rights that the two programs need."""
    named = variant.resolve
    topics = tuple(map(named, ("latched", "numbers", "direct")))
    server, client = variant.names["server"], variant.names["client"]
    entitle(
        site,
        server,
        {
            Right.PUBLISH: (*topics, "/clock"),
            Right.PROVIDE: (named("switch"),),
            Right.PARAM_SET: (named("shared/colour"), "/use_sim_time"),
            Right.PARAM_GET: ("/use_sim_time",),
        },
    )
    entitle(
        site,
        client,
        {
            Right.SUBSCRIBE: (*topics, "/clock"),
            Right.CALL: (named("switch"),),
            Right.PARAM_GET: (named("shared"), named("shared/*"), "/use_sim_time", f"{client}/**"),
            Right.PARAM_SET: (f"{client}/**",),
        },
    )


async def play(site: Site, logs: Path, variant: Variant, **more: str) -> list[str]:
    """Run the pair; the lines in which the client prints what it received."""
    entitle_both(site, variant)
    env = environment(site, logs, **more)
    async with program(env, SERVER, *variant.arguments("server")) as server:
        await server.read_until("SERVING")
        async with program(env, CLIENT, *variant.arguments("client"), "_volume:=11") as client:
            await client.read_until("DONE", within=60)
        assert "rossec: " not in server.said + client.said, server.said + client.said
        return [line for line in client.said.splitlines() if line.startswith("SEEN")]


async def main(directory: Path, host: str) -> None:
    """Every variant in turn, each with a master of its own."""
    more = {"ROS_IP": "127.0.0.1"}
    if ":" in host:
        more = {"ROS_IP": "::1", "ROS_IPV6": "on"}
    for number, (name, variant) in enumerate(VARIANTS.items()):
        site = Site(directory / f"site{number}")
        site.host = host
        async with site.running():
            for line in await play(site, directory / f"logs{number}", variant, **more):
                sys.stdout.write(f"{name}: {line}\n")


if __name__ == "__main__":

    def _main(arguments: Sequence[str]) -> None:
        asyncio.run(main(Path(arguments[0]), arguments[1]))

    _main(sys.argv[1:])
