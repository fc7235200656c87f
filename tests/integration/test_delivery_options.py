"""A subscriber behind a slow line and its options, with publishers of every form.

Each publisher has two subscribers, one with options and one without; both forms of rospy subscribe
as well, and know of no option. The line is so slow that more waits than has left.
"""

import contextlib
import os
import re
import subprocess
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Final

import pytest

from grants.model import Restriction
from rossec.channel.records import TAG
from tests.integration.sidecarworld import ROSSEC, Running, World, wait
from tests.support.fleet import SECURE
from tests.support.hosts import Hosts, two_hosts
from tests.support.kinds import KINDS, command
from tests.support.site import Site

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]
each_kind = pytest.mark.parametrize("kind", KINDS)
KBIT: Final = 800
BURST: Final = 100  # messages of 10 kB: ten seconds of the line
RATE: Final = 2.0
PAD: Final = 512

_ROSPY_SPEAKER: Final = """
import os, sys, time, rospy
from std_msgs.msg import String
kind, begin, count = sys.argv[1], sys.argv[2], int(sys.argv[3])
rospy.init_node(f"{kind}_speaker")
burst = rospy.Publisher(f"/{kind}/burst", String, queue_size=2 * count)
steady = rospy.Publisher(f"/{kind}/steady", String, queue_size=100)
text = rospy.Publisher(f"/{kind}/text", String, queue_size=10)
words = rospy.Publisher(f"/{kind}/words", String, queue_size=10)
print("READY", flush=True)
number, due = 0, True
while not rospy.is_shutdown():
    steady.publish(f"{number}")
    words.publish("x" * (number % 200))
    if number % 20 == 0:
        text.publish("over and over " * 2000)
    if due and os.path.exists(begin) and burst.get_num_connections() == 2:
        due = False
        for each in range(count):
            burst.publish(f"{each} " + "x" * 10000)
    number += 1
    time.sleep(0.05)
"""
_BUILTIN_SPEAKER: Final = """
import asyncio, os, sys
from rossec.node import Node
async def main(kind, begin, count):
    async with Node(f"/{kind}_speaker") as node:
        burst = await node.publisher(f"/{kind}/burst", "std_msgs/String", queue_size=2 * count)
        steady = await node.publisher(f"/{kind}/steady", "std_msgs/String", queue_size=100)
        text = await node.publisher(f"/{kind}/text", "std_msgs/String")
        words = await node.publisher(f"/{kind}/words", "std_msgs/String")
        print("READY", flush=True)
        number, due = 0, True
        while True:
            steady.publish(steady.create(data=f"{number}"))
            words.publish(words.create(data="x" * (number % 200)))
            if number % 20 == 0:
                text.publish(text.create(data="over and over " * 2000))
            if due and os.path.exists(begin) and len(burst.links) == 2:
                due = False
                for each in range(count):
                    burst.publish(burst.create(data=f"{each} " + "x" * 10000))
            number += 1
            await asyncio.sleep(0.05)
asyncio.run(main(sys.argv[1], sys.argv[2], int(sys.argv[3])))
"""
_ROSPY_LISTENER: Final = """
import sys, rospy
from std_msgs.msg import String
kind = sys.argv[1]
rospy.init_node(f"{kind}_listener")
def hear(message, about):
    sys.stdout.write(f"HEARD {about} {message.data}\\n")
    sys.stdout.flush()
for other in sys.argv[2].split():
    rospy.Subscriber(f"/{other}/steady", String, hear, f"{other} steady", queue_size=100)
rospy.spin()
"""
_WISHING: Final = """
import asyncio, sys, time
from rossec.channel.connection import Connection
from rossec.node import Node, subscriber
from rossec.participant.delivery_options import accepted_options
followed = subscriber.requested_messages
def tell(asked, answer, limit):
    said = asked and accepted_options(answer, asked)
    if asked:
        print("TAKEN", answer["topic"].decode(), asked == said, flush=True)
    return followed(asked, answer, limit)
subscriber.requested_messages = tell
take_padded = Connection._on_padded_end
def padded(self, head, body):
    print("PADDED", self._peer.name, len(body), flush=True)
    return take_padded(self, head, body)
Connection._on_padded_end = padded
async def hear(topic, about):
    async for message in topic:
        number = message.data.partition(" ")[0]
        print("HEARD", about, number, len(message.data), time.monotonic(), flush=True)
async def main(kinds, rate):
    async with (
        Node("/wishing") as wishing, Node("/plain") as plain, Node("/padded") as unseen,
        asyncio.TaskGroup() as group,
    ):
        async def follow(node, topic, about, **options):
            found = await node.subscriber(topic, "std_msgs/String", queue_size=1000, **options)
            group.create_task(hear(found, about))
        for kind in kinds:
            await follow(wishing, f"/{kind}/burst", f"{kind} newest", newest=True)
            await follow(plain, f"/{kind}/burst", f"{kind} oldest")
            await follow(wishing, f"/{kind}/steady", f"{kind} rate", rate=rate)
            await follow(wishing, f"/{kind}/text", f"{kind} deflated", deflate=True)
            await follow(unseen, f"/{kind}/words", f"{kind} padded", deflate=True)
        print("READY", flush=True)
asyncio.run(main(sys.argv[2].split(), float(sys.argv[3])))
"""
SPEAKERS: Final[Mapping[str, str]] = {
    "inprocess": SECURE + _ROSPY_SPEAKER,
    "builtin": _BUILTIN_SPEAKER,
    "sidecar": _ROSPY_SPEAKER,
}
LISTENERS: Final = {"inprocess": SECURE + _ROSPY_LISTENER, "sidecar": _ROSPY_LISTENER}


@dataclass(frozen=True)
class Cast:
    """Who listens at the far end of the line."""

    wishing: Running
    others: Mapping[str, Running]

    def heard(self, kind: str, about: str) -> list[tuple[int, int, float]]:
        """Number, length and time of arrival of the messages heard so far."""
        said = re.findall(rf"^HEARD {kind} {about} (\w+) (\d+) ([\d.]+)\n", self.wishing.said, re.MULTILINE)
        return [
            (int(number) if number.isdecimal() else -1, int(length), float(at)) for number, length, at in said
        ]


def slow(hosts: Hosts) -> None:
    """Give the way from the near host to the far one its rate; little may wait in it."""
    shape = f"tc qdisc replace dev rossec0 root tbf rate {KBIT}kbit burst 3200 limit 30000"
    subprocess.run(hosts.near.at(*shape.split()), check=True, capture_output=True)


@pytest.fixture(scope="module")
def cast(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cast]:
    directory = tmp_path_factory.mktemp("wishes")
    with contextlib.ExitStack() as stack:
        hosts = stack.enter_context(two_hosts())
        if not hosts.real:
            assert not os.environ.get("CI"), "there network namespaces must be permitted"
            pytest.skip("NOT RUN: needs network namespaces")
        world = World(hosts, Site(directory / "site"), directory)
        for kind in KINDS:
            world.enroll(f"/{kind}_speaker", publish=f"/{kind}/*")
        for name in ("/wishing", "/plain", *(f"/{kind}_listener" for kind in LISTENERS)):
            world.enroll(name, subscribe="/*/*")
        world.enroll("/padded")
        world.site.subscribe("/padded", "/*/words", Restriction(pad=PAD))
        stack.enter_context(world.master())
        begin, kinds = directory / "begin", " ".join(KINDS)

        def start(host: str, kind: str, source: str, *more: str) -> Running:
            line = command(kind, sys.executable, ROSSEC, source, *more)
            return stack.enter_context(world.started(getattr(hosts, host), *line))

        speakers = [start("near", kind, SPEAKERS[kind], str(begin), str(BURST)) for kind in KINDS]
        for speaker in speakers:
            speaker.wait_for("READY")
        others = {kind: start("far", kind, LISTENERS[kind], kinds) for kind in LISTENERS}
        wishing = start("far", "builtin", _WISHING, kinds, str(RATE))
        found = Cast(wishing, others)
        wishing.wait_for("READY")
        wait(lambda: wishing.said.count("TAKEN") >= 4 * len(KINDS))
        wait(lambda: all(found.heard(kind, "rate") for kind in KINDS))
        slow(hosts)
        begin.touch()
        yield found


@each_kind
def test_every_form_of_publisher_takes_every_wish(cast: Cast, kind: str) -> None:
    for topic in ("burst", "steady", "text"):
        assert f"TAKEN /{kind}/{topic} True" in cast.wishing.said


@each_kind
def test_the_newest_comes_before_most_that_are_older(cast: Cast, kind: str) -> None:
    wait(lambda: any(number == BURST - 1 for number, _, _ in cast.heard(kind, "newest")))
    numbers = [number for number, _, _ in cast.heard(kind, "newest")]
    assert numbers == sorted(set(numbers))
    assert len(numbers) < BURST / 2


@each_kind
def test_without_the_wish_the_oldest_come_first(cast: Cast, kind: str) -> None:
    wait(lambda: len(cast.heard(kind, "oldest")) >= 10)
    assert [number for number, _, _ in cast.heard(kind, "oldest")][:10] == list(range(10))


@each_kind
def test_the_rate_is_kept(cast: Cast, kind: str) -> None:
    wait(lambda: len(cast.heard(kind, "rate")) >= 8)
    heard = cast.heard(kind, "rate")
    numbers = [number for number, _, _ in heard]
    assert numbers == sorted(set(numbers))
    # By the publisher's own count: it sends 20 a second at most.
    assert numbers[-1] - numbers[0] >= (len(numbers) - 3) * 20 / RATE * 0.5


@each_kind
def test_deflated_messages_are_whole(cast: Cast, kind: str) -> None:
    wait(lambda: len(cast.heard(kind, "deflated")) >= 3)
    assert {length for _, length, _ in cast.heard(kind, "deflated")} == {len("over and over " * 2000)}


@each_kind
def test_every_form_pads_what_the_grant_says(cast: Cast, kind: str) -> None:
    """And does not deflate it: `False` says that this option was not taken."""
    wait(lambda: len({length for _, length, _ in cast.heard(kind, "padded")}) >= 10)
    assert f"TAKEN /{kind}/words False" in cast.wishing.said
    sizes = re.findall(rf"PADDED /{kind}_speaker (\d+)\n", cast.wishing.said)
    assert len(sizes) >= 10
    assert {int(size) for size in sizes} <= {PAD + TAG, 2 * PAD + TAG}


@pytest.mark.parametrize("sink", LISTENERS)
@each_kind
def test_others_get_every_message_of_the_same_publisher(cast: Cast, kind: str, sink: str) -> None:
    listener = cast.others[sink]
    wait(lambda: listener.said.count(f"HEARD {kind} steady ") >= 40)
    numbers = [int(n) for n in re.findall(rf"HEARD {kind} steady (\d+)\n", listener.said)]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
