"""A rule that gets narrower acts on open connections, between two messages, in every form.

On the side of a publisher (what it sends a subscriber), and of a subscriber (what it takes from a
publisher). A right to call is renewed on a persistent connection.
"""

import asyncio
import contextlib
import sys
import time
from pathlib import Path
from typing import Any, Final

import pytest

from grants.model import Restriction, Right, filter_rules
from rossec.errors import AnswerRefused
from rossec.node import Publisher, Subscriber
from tests.support import stock
from tests.support.fleet import SECURE, entitle, environment
from tests.support.site import Site
from tests.support.talking import Heard, Talking, cancelled, started
from tests.support.witness import until

TYPE: Final = "std_msgs/String"
FORMS: Final = ("inside", "beside", "own")
MOUTH: Final = "/mouth/text"
LIFE: Final = 25  # seconds: of the first right to call

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

TALKER: Final = """
import rospy, sys, time
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
words = rospy.Publisher(sys.argv[2], String, queue_size=100)
number = 0
while not rospy.is_shutdown():
    words.publish(f"{number:06d}abcdefghij")
    number += 1
    time.sleep(1 / 20)
"""
LISTENER: Final = """
import json, rospy, sys, time
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
topic = sys.argv[2]
heard = [0, None, [], 0]
def hear(message):
    global heard
    count, last, gaps, _ = heard
    number = int(message.data[:6])
    if last is not None and number != last + 1:
        gaps.append([last, number])
    heard = [count + 1, number, gaps, len(message.data)]
rospy.Subscriber(topic, String, hear)
while not rospy.is_shutdown():
    print("HEARD", json.dumps({topic: heard}), flush=True)
    time.sleep(0.2)
"""
SERVER: Final = (
    SECURE
    + """
import rospy
from std_srvs.srv import SetBool
rospy.init_node("inside_server")
rospy.Service("/inside/call", SetBool, lambda asked: (asked.data, "served"))
print("READY", flush=True)
rospy.spin()
"""
)
CLIENT: Final = (
    SECURE
    + """
import json, rospy, time
from std_srvs.srv import SetBool
rospy.init_node("inside_client")
print("READY", flush=True)
rospy.wait_for_service("/own/call", timeout=60)  # until it has the right
kept, count = None, 0
while not rospy.is_shutdown():
    try:
        if kept is None:
            kept = rospy.ServiceProxy("/own/call", SetBool, persistent=True)
        kept(True)
        count += 1
    except rospy.ServiceException:
        assert not count, "a connection that was open was made anew"
        kept = None
    print("HEARD", json.dumps({"/own/call": [count]}), flush=True)
    time.sleep(0.2)
"""
)


def short(length: int) -> Restriction:
    return Restriction(TYPE, (), filter_rules({"data": {"truncate": {"length": length}}}))


async def listen(subscriber: Subscriber, heard: Heard) -> None:
    count, last, gaps = 0, None, []
    async for message in subscriber:
        number = int(message.data[:6])
        if last is not None and number != last + 1:
            gaps.append([last, number])
        count, last = count + 1, number
        heard[subscriber.topic] = [count, last, gaps, len(message.data)]


async def talk(publisher: Publisher) -> None:
    number = 0
    while True:
        publisher.publish(publisher.create(data=f"{number:06d}abcdefghij"))
        number += 1
        await asyncio.sleep(1 / 20)


def rights(site: Site) -> None:
    """Of the publishers, the subscribers, `/ear` that hears all, and `/mouth` that all hear."""
    site.grant("/mouth", Right.PUBLISH, MOUTH, restriction=short(12))
    for form in FORMS:
        entitle(site, f"/{form}_talker", {Right.PUBLISH: (f"/{form}/text", "/rosout")})
        entitle(site, f"/{form}_listener", {Right.SUBSCRIBE: (MOUTH,), Right.PUBLISH: ("/rosout",)})
        site.subscribe("/ear", f"/{form}/text", short(12))


async def test_a_narrower_rule_acts_between_two_messages(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    rights(site)
    run = (str(Path(sys.executable).parent / "rossec"), "run", "--as")
    heard: Heard = {}
    async with contextlib.AsyncExitStack() as stack:
        await stack.enter_async_context(site.running())
        env = environment(site, tmp_path)
        names = ("/ear", "/mouth", "/own_talker", "/own_listener")
        ear, mouth, own, hearer = [await stack.enter_async_context(site.node(name)) for name in names]

        async def start(*command: str) -> Talking:
            return await stack.enter_async_context(started(env, *command))

        await start(*stock.python(SECURE + TALKER, "inside_talker", "/inside/text"))
        talker = stock.python(TALKER, "beside_talker", "/beside/text")
        await start(*run, "/beside_talker", "--", *talker)
        listener = stock.python(LISTENER, "beside_listener", MOUTH)
        listeners = [
            await start(*stock.python(SECURE + LISTENER, "inside_listener", MOUTH)),
            await start(*run, "/beside_listener", "--", *listener),
        ]
        group = await stack.enter_async_context(cancelled())
        group.create_task(talk(await own.publisher("/own/text", TYPE, queue_size=100)))
        group.create_task(talk(await mouth.publisher(MOUTH, TYPE, queue_size=100)))
        for form in FORMS:
            group.create_task(listen(await ear.subscriber(f"/{form}/text", TYPE), heard))
        group.create_task(listen(await hearer.subscriber(MOUTH, TYPE), heard))

        def results() -> list[Any]:
            own_ones = [heard.get(f"/{form}/text", [0, 0, [], 0]) for form in FORMS]
            others = [each.heard.get(MOUTH, [0, 0, [], 0]) for each in listeners]
            return [*own_ones, heard.get(MOUTH, [0, 0, [], 0]), *others]

        def all_have(length: int) -> bool:
            return all(each[3] == length for each in results())

        await until(lambda: all_have(12), within=90)
        for form in FORMS:
            site.subscribe("/ear", f"/{form}/text", short(9))
        site.grant("/mouth", Right.PUBLISH, MOUTH, restriction=short(9))
        await until(lambda: all_have(9), within=60)
        assert not [each[2] for each in results() if each[2]], "nothing was lost or came twice"


async def test_a_persistent_connection_outlives_the_first_right_to_call(tmp_path: Path) -> None:
    """Of a rospy client to a built-in server, and the other way round."""
    site = Site(tmp_path / "site")
    entitle(site, "/inside_server", {Right.PROVIDE: ("/inside/call",)})
    entitle(site, "/own_server", {Right.PROVIDE: ("/own/call",)})
    site.enroll("/inside_client")
    async with site.running(), site.node("/own_server") as server, site.node("/own_client") as node:
        service = await server.service("/own/call", "std_srvs/SetBool", lambda _: {"success": True})
        env = environment(site, tmp_path)
        async with (
            started(env, *stock.python(SERVER)) as inside,
            started(env, *stock.python(CLIENT)) as client,
        ):
            await until(lambda: "READY" in inside.said and "READY" in client.said, within=60)
            calls = node.client("/inside/call", "std_srvs/SetBool", persistent=True)
            for name, called in (("/own_client", "/inside/call"), ("/inside_client", "/own/call")):
                site.grant(name, Right.CALL, called, lifetime=LIFE)
            ends = time.time() + LIFE

            served = None
            while served is None:  # until the master has told of the right, or it has ended
                assert time.time() < ends
                await asyncio.sleep(0.2)
                with contextlib.suppress(AnswerRefused):
                    served = await calls(data=True)
            assert served.message == "served"
            await until(lambda: client.heard.get("/own/call", [0])[0] > 0, within=LIFE)
            links = [*calls.links, *service.links]
            assert len(links) == 2
            for name, called in (("/own_client", "/inside/call"), ("/inside_client", "/own/call")):
                site.grant(name, Right.CALL, called)
            while time.time() < ends + 2:
                assert (await calls(data=True)).success
                await asyncio.sleep(0.2)
            before = client.heard["/own/call"][0]
            await until(lambda: client.heard["/own/call"][0] > before, within=20)
            assert [*calls.links, *service.links] == links, "no connection was made anew"
