"""Two programs run while keys, grants, identities, lists and the master change.

Short limits replace long times: keys are renewed every 64 records or second, grants expire after a
few seconds and are renewed by the master, the authority's list changes twice a second. Messages are
lost only where the documents say so: when a grant ends, a subscriber connects again.
"""

import asyncio
import re
import secrets
import time
from pathlib import Path
from typing import Final

import pytest

from ca.revocation.trust_status import SKEW
from grants.model import Right
from tests.support.attacker import call, credentials
from tests.support.fleet import SECURE, Program, environment, program
from tests.support.site import DAY, Site

pytestmark = pytest.mark.ros

TOPIC: Final = "/day/count"
SECONDS: Final = 15.0
LIFETIME: Final = 7
FAST: Final = """
from rossec.inprocess import identity
from rossec.channel.records import ChannelLimits
limits = dict.fromkeys(identity.WireProtocol, ChannelLimits(records=64, seconds=1))
identity.ACCEPTED = identity.DIALLED = limits
import rossec.participant.renewals
rossec.participant.renewals.RETRY = 1
"""
TALKER: Final = (
    SECURE
    + FAST
    + """
import rospy, time
from std_msgs.msg import String
rospy.init_node("talker")
words = rospy.Publisher("/day/count", String, queue_size=1000)
print("READY", flush=True)
number = 0
while not rospy.is_shutdown():
    words.publish(str(number))
    number += 1
    time.sleep(0.003)
"""
)
LISTENER: Final = (
    SECURE
    + FAST
    + """
import rospy, sys, threading
from std_msgs.msg import String
rospy.init_node("listener")
last, gaps, count = None, 0, 0
def hear(message):
    global last, gaps, count
    number = int(message.data)
    if last is not None and number != last + 1:
        gaps += 1
    last, count = number, count + 1
rospy.Subscriber("/day/count", String, hear)
print("READY", flush=True)
def report():
    for line in sys.stdin:
        print("REPORT", count, gaps, threading.active_count(), flush=True)
threading.Thread(target=report, daemon=True).start()
rospy.spin()
"""
)


def resident(running: Program) -> int:
    """Resident memory in kilobytes."""
    status = Path(f"/proc/{running.process.pid}/status").read_text()
    return int(status.partition("VmRSS:")[2].split()[0])


def descriptors(running: Program) -> int:
    return len(list(Path(f"/proc/{running.process.pid}/fd").iterdir()))


async def report(listener: Program) -> tuple[int, int, int]:
    """Messages received, gaps among them, threads."""
    await listener.tell("now")
    _, count, gaps, threads = (await listener.read_until("REPORT")).split()
    return int(count), int(gaps), int(threads)


async def change_the_list(site: Site) -> None:
    assert site.master is not None
    data = site.revoke(secrets.token_bytes(32))
    carrier = credentials(site, "/carrier")
    await call(site.master.uri, carrier, "rossec.updateRevocations", "/carrier", data)


async def test_a_day_passes_without_unreported_losses(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.delegate(LIFETIME + SKEW)
    async with site.running():
        site.publish("/talker", TOPIC)
        site.grant("/listener", Right.SUBSCRIBE, TOPIC, lifetime=LIFETIME, cap=DAY)
        env = environment(site, tmp_path / "logs")
        async with program(env, TALKER, told=True) as talker, program(env, LISTENER, told=True) as listener:
            await talker.read_until("READY")
            await listener.read_until("READY")
            begin, step = time.monotonic(), 0
            early, fds = (0, 0), (0, 0)
            while time.monotonic() < begin + SECONDS:
                await asyncio.sleep(0.5)
                await change_the_list(site)
                step += 1
                if step == 5:
                    site.renew("/talker")
                    site.renew("/listener")
                if step == 12:
                    await site.restart_master()
                if step == 14:
                    early = resident(talker), resident(listener)
                    fds = descriptors(talker), descriptors(listener)
            before, _, _ = await report(listener)
            await asyncio.sleep(0.5)
            count, gaps, threads = await report(listener)
            assert count > before, "the grant that was signed has ended twice over"
            renewals = (time.monotonic() - begin) // (LIFETIME / 2)  # from half of the lifetime on
            late = resident(talker), resident(listener)
            assert count > SECONDS * 50
            assert gaps <= renewals, "one for each grant that ended, and none besides"
            assert threads < 15
            assert all(b - a < 4096 for a, b in zip(early, late, strict=True)), (early, late)
            now = descriptors(talker), descriptors(listener)
            assert all(b <= a + 4 for a, b in zip(fds, now, strict=True)), (fds, now)
            said = talker.said + listener.said
    assert "Traceback" not in said
    assert not re.search(r"rossec: (?!.*(master|cut|lost|grant))", said), said
