"""A rospy process renews what expires, and closes connections without fresh revocation data."""

import time
from pathlib import Path

import pytest

from grants.model import Right
from rossec.master.rights import revocation_lists
from rossec.master.state.registry import Kind
from tests.rossec.participant.test_identity_renewal import BEGIN, LIFE, below
from tests.support.blocked import BlockedNodes
from tests.support.fleet import SECURE, environment, program
from tests.support.site import DAY, HOUR, Site
from tests.support.witness import until

pytestmark = pytest.mark.ros

WORDS = "/robot/words"
TYPE = "std_msgs/String"
LISTENER = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
rospy.init_node("listener")
rospy.Subscriber("/robot/words", String, lambda message: print("HEARD", message.data, flush=True))
print("READY", flush=True)
rospy.spin()
"""
)
HASTY = (
    """
import rossec.participant.authorized
from rossec.participant.membership import Membership
rossec.participant.authorized.STALE_GRACE = 1
take = Membership.update_revocations
def take_and_print(*data):
    take(*data)
    print("UPDATED", flush=True)
Membership.update_revocations = take_and_print
"""
    + LISTENER
)


async def test_expired_grants_and_ageing_identities_are_renewed(tmp_path: Path) -> None:
    """A grant that expired while the program was off, an identity at two thirds of its life."""
    site = Site(tmp_path / "site", clock=lambda: BEGIN)
    for name in ("/robot", "/listener", "/master"):
        site.enroll(name, LIFE)
    before = site.identity("/listener")
    site._clock = time.time
    site.intermediate = below(site)
    site.delegate()
    site.publish("/robot", WORDS)
    site.grant("/listener", Right.SUBSCRIBE, WORDS, begin=site.now() - HOUR, lifetime=-60, cap=DAY)
    async with site.running(), site.node("/robot") as robot:
        publisher = await robot.publisher(WORDS, TYPE, latch=True)
        publisher.publish(publisher.create(data="hello"))
        async with program(environment(site, tmp_path), LISTENER) as listener:
            await listener.read_until("HEARD hello")
            [link] = publisher.links
            assert len(link.decision.grant_ids) == 3  # the grant, the delegation, the delegate
            await until(lambda: site.identity("/listener").not_after > before.not_after, within=30)
            assert site.identity("/listener").issuers == (site.intermediate.authority.issuer.thumbprint,)
            for old in tuple(publisher.links):
                old.stream.abort("a test")
            await until(lambda: any(link.stream.peer.issuers for link in publisher.links), within=30)
            await listener.read_until("HEARD hello")
    assert "Traceback" not in listener.said


async def test_connections_end_when_the_list_is_not_confirmed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    site = Site(tmp_path / "site")
    site.publish("/robot", WORDS)
    site.subscribe("/listener", WORDS)
    async with site.running(), site.node("/robot") as robot:
        publisher = await robot.publisher(WORDS, TYPE, latch=True)
        publisher.publish(publisher.create(data="hello"))
        async with program(environment(site, tmp_path), HASTY) as listener:
            await listener.read_until("HEARD hello")
            monkeypatch.setattr(revocation_lists, "MAX_AGE", 1)  # of what the master says from now on
            await robot._membership.session.call("rossec.updateRevocations", site.revoke(bytes(32)))
            await listener.read_until("UPDATED")
            assert site.master is not None
            await site.master.close()
            closed = await listener.read_until(
                "closed the connection with /robot (/robot/words): ", within=90
            )
            assert "the last confirmation expired" in closed
    assert "Traceback" not in listener.said


EARLY = (
    SECURE
    + """
import rospy, threading, time
import rospy.impl.registration as registration
from std_msgs.msg import String
start = registration.RegManager.start
def start_late(manager, *arguments):  # as when the master is not there yet
    while not made:
        time.sleep(0.01)
    start(manager, *arguments)
registration.RegManager.start = start_late
made = []
def make():
    made.append(rospy.Publisher("/robot/words", String, queue_size=1, latch=True))
    rospy.Subscriber("/robot/orders", String, print)
threading.Timer(0.2, make).start()
rospy.init_node("robot")
made[0].publish("hello")
print("READY", flush=True)
rospy.spin()
print("ENDED", flush=True)
"""
)


async def test_refused_registrations_are_repeated_with_a_grant(tmp_path: Path) -> None:
    """Topics that rospy registers while it starts do not end the program."""
    site = Site(tmp_path / "site")
    site.enroll("/robot")
    site.subscribe("/listener", WORDS)
    async with site.running(), program(environment(site, tmp_path), EARLY) as robot:
        await robot.read_until("READY")
        async with site.node("/listener") as listener:
            words = await listener.subscriber(WORDS, TYPE)
            site.publish("/robot", WORDS)
            await until(lambda: words.received > 0, within=30)
        assert "rossec: /robot may not publish /robot/words: an allow rule for" in robot.said
        assert "FATAL" not in robot.said
        assert "ENDED" not in robot.said


CRASHING = (
    SECURE
    + """
import rospy
from rossec.participant.connections import ConnectionTable
from std_msgs.msg import String
rospy.init_node("robot")
rospy.Publisher("/robot/words", String, queue_size=1)
def fail(connections, now):
    raise RuntimeError("a fault of ours")
ConnectionTable.cut_ended = fail
rospy.spin()
try:
    rospy.get_param("/x")
except OSError as error:
    print("SAID", error, flush=True)
"""
)


async def test_a_background_loop_that_crashes_ends_the_node(tmp_path: Path) -> None:
    """It unregisters the node at the master, which must not wait for the loop itself."""
    site = Site(tmp_path / "site")
    site.publish("/robot", WORDS)
    async with site.running(), program(environment(site, tmp_path), CRASHING) as robot:
        assert await robot.ends(within=60) == 0
    assert "the background loop failed, all connections are closed: a fault of ours" in robot.said
    assert "SAID [Errno 111] rossec: the background loop of this process has ended" in robot.said


async def test_a_publisher_that_is_not_registered_again_yet_is_reconnected(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The master was restarted and names no publisher; then the connection breaks."""
    absent = BlockedNodes(monkeypatch)
    site = Site(tmp_path / "site")
    site.publish("/robot", WORDS)
    site.subscribe("/listener", WORDS)
    async with site.running(), site.node("/robot") as robot:
        publisher = await robot.publisher(WORDS, TYPE, latch=True)
        publisher.publish(publisher.create(data="hello"))
        async with program(environment(site, tmp_path), LISTENER) as listener:
            await listener.read_until("HEARD hello")
            absent.names = {"/robot"}
            await site.restart_master()
            assert site.master is not None
            registry = site.master.state.registry
            await until(lambda: registry.registered_nodes(Kind.SUBSCRIBER, WORDS))
            for link in tuple(publisher.links):
                link.stream.abort("a test")
            await listener.read_until("HEARD hello")
            assert registry.registered_nodes(Kind.PUBLISHER, WORDS) == ()
