"""A fleet whose grants and identities are renewed all the time loses no message, in any form.

Three publishers of 20 messages a second and three subscribers: in-process, behind a sidecar and
built in; every subscriber hears every publisher. The master renews grants by a delegation, and
identities with an intermediate. `ROSSEC_FLEET_SECONDS` and `ROSSEC_FLEET_LIVES` (of a ticket and
of an identity) make the run longer: 120 or 600, and `10,40`.
"""

import asyncio
import contextlib
import logging
import os
import sys
import time
from collections.abc import AsyncIterator, Iterable
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from ca.authority import Authority
from ca.certificates import build_intermediate_request, from_pem
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.trust_status import SKEW
from ca.store.record import Store
from grants.model import Right
from rossec.authority import renewals
from rossec.authority.signing import SigningAuthority
from rossec.node import Publisher, Subscriber
from tests.support import stock
from tests.support.fleet import SECURE, environment
from tests.support.site import DAY, Site
from tests.support.talking import Heard, Talking, cancelled, started
from tests.support.witness import until

SECONDS: Final = float(os.environ.get("ROSSEC_FLEET_SECONDS", "40"))
TICKET, LIFE = map(int, os.environ.get("ROSSEC_FLEET_LIVES", "10,18").split(","))
RATE: Final = 20
TYPE: Final = "std_msgs/String"
FORMS: Final = ("inside", "beside", "own")
TOPICS: Final = tuple(f"/{form}/count" for form in FORMS)

pytestmark = [pytest.mark.ros, pytest.mark.timeout(SECONDS + 240)]

TALKER: Final = """
import rospy, sys, time
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
words = rospy.Publisher(sys.argv[2], String, queue_size=100)
print("READY", flush=True)
number = 0
while not rospy.is_shutdown():
    words.publish(str(number))
    number += 1
    time.sleep(1 / 20)
"""
LISTENER: Final = """
import json, rospy, sys, time
from std_msgs.msg import String
rospy.init_node(sys.argv[1])
heard = {topic: [0, None, []] for topic in sys.argv[2:]}
def hear(message, topic):
    count, last, gaps = heard[topic]
    number = int(message.data)
    if last is not None and number != last + 1:
        gaps.append([last, number])
    heard[topic] = [count + 1, number, gaps]
for topic in heard:
    rospy.Subscriber(topic, String, hear, topic)
while not rospy.is_shutdown():
    print("HEARD", json.dumps(heard), flush=True)
    time.sleep(1)
"""


def enroll(site: Site, name: str, right: Right, topics: Iterable[str]) -> None:
    """A node whose rights to `topics` are confirmed for `TICKET` seconds at a time."""
    site.enroll(name, LIFE)
    for topic in topics:
        site.grant(name, right, topic, begin=site.now() - 1, lifetime=TICKET, cap=DAY)
    site.publish(name, "/rosout")
    for service in ("get_loggers", "set_logger_level"):
        site.grant(name, Right.PROVIDE, f"{name}/{service}")
    site.grant(name, Right.PARAM_GET, "/**")


def intermediate_of(site: Site) -> SigningAuthority:
    """What `rossec master --renew-identities` renews with."""
    signer = KeySigner(generate())
    request = build_intermediate_request(signer, site.anchor.domain)
    _, bundle = renewals.sign_intermediate(site.authority, request, site.now(), may_enroll=False)
    der, root = from_pem(bundle)
    path = site.root / "below"
    path.mkdir()
    return SigningAuthority(Authority(signer, root, der), Store.create(path / "ca.db"), path)


async def talk(publisher: Publisher) -> None:
    number = 0
    while True:
        publisher.publish(publisher.create(data=str(number)))
        number += 1
        await asyncio.sleep(1 / RATE)


async def listen(subscriber: Subscriber, heard: Heard) -> None:
    count, last, gaps = 0, None, []
    async for message in subscriber:
        number = int(message.data)
        if last is not None and number != last + 1:
            gaps.append([last, number])
        count, last = count + 1, number
        heard[subscriber.topic] = [count, last, gaps]


@contextlib.asynccontextmanager
async def fleet(site: Site, directory: Path) -> AsyncIterator[tuple[Publisher, list[Talking], Heard]]:
    """All six: the built-in publisher, the programs, and what the built-in subscriber hears."""
    env = environment(site, directory)
    run = (str(Path(sys.executable).parent / "rossec"), "run", "--as")
    async with contextlib.AsyncExitStack() as stack:
        own = await stack.enter_async_context(site.node("/own_talker"))
        ear = await stack.enter_async_context(site.node("/own_listener"))

        async def start(*command: str) -> Talking:
            return await stack.enter_async_context(started(env, *command))

        talker = stock.python(TALKER, "beside_talker", TOPICS[1])
        listener = stock.python(LISTENER, "beside_listener", *TOPICS)
        programs = [
            await start(*stock.python(SECURE + TALKER, "inside_talker", TOPICS[0])),
            await start(*run, "/beside_talker", "--", *talker),
            await start(*stock.python(SECURE + LISTENER, "inside_listener", *TOPICS)),
            await start(*run, "/beside_listener", "--", *listener),
        ]
        publisher = await own.publisher(TOPICS[2], TYPE, queue_size=100)
        group = await stack.enter_async_context(cancelled())
        group.create_task(talk(publisher))
        heard: Heard = {}
        for topic in TOPICS:
            subscriber = await ear.subscriber(topic, TYPE, queue_size=100)
            group.create_task(listen(subscriber, heard))
        yield publisher, programs, heard


async def test_renewals_lose_no_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr("tests.support.site.renew", partial(renewals.renew, lifetime=LIFE))
    caplog.set_level(logging.INFO)
    site = Site(tmp_path / "site")
    site.delegate(TICKET + SKEW)
    site.intermediate = intermediate_of(site)
    for form, topic in zip(FORMS, TOPICS, strict=True):
        enroll(site, f"/{form}_talker", Right.PUBLISH, (topic,))
        enroll(site, f"/{form}_listener", Right.SUBSCRIBE, TOPICS)
    async with site.running(), fleet(site, tmp_path) as (publisher, programs, heard):
        listeners = [programs[2], programs[3]]

        def all_heard() -> list[Heard]:
            return [heard, *(each.heard for each in listeners)]

        def everybody_hears() -> bool:
            return all(each.get(topic, [0])[0] > 0 for each in all_heard() for topic in TOPICS)

        await until(everybody_hears, within=90)
        lines = [len(each.lines) for each in programs]
        caplog.clear()
        links = {link: link.stream.peer.serial for link in publisher.links}
        assert len(links) == 3
        before = [{topic: each[topic][0] for topic in TOPICS} for each in all_heard()]
        began = time.monotonic()
        while time.monotonic() < began + SECONDS:
            await asyncio.sleep(1)
            gaps = [each[topic][2] for each in all_heard() for topic in TOPICS]
            assert not any(gaps), (gaps, [each.said for each in programs])
        for each, then in zip(all_heard(), before, strict=True):
            for topic in TOPICS:
                assert each[topic][0] - then[topic] > SECONDS * RATE * 0.5
        assert set(publisher.links) == set(links), "no connection was made anew"
        assert all(link.stream.peer.serial != serial for link, serial in links.items())
        said = [line for each, n in zip(programs, lines, strict=True) for line in each.lines[n:]]
        assert not [line for line in said if "WARN" in line or "closed" in line], said
        assert not [each for each in caplog.records if each.levelno >= logging.WARNING]
        heard_now = sum(each[topic][0] for each in all_heard() for topic in TOPICS)
        sent = sum(each[topic] for each in before for topic in each)
        logging.getLogger("fleet").info("%d messages heard, none lost", heard_now - sent)
