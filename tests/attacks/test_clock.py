"""The host's clock is set back: rights end when they would have ended otherwise.

The clocks are injected: what the host shows, and the seconds that cannot be set, of this process
(the built-in node, the sidecar, the master) or of a rospy program.
"""

import asyncio
import time
from collections.abc import AsyncIterator, Callable
from functools import partial
from pathlib import Path
from typing import Final

import pytest

from ca.errors import RevocationRefused, RevocationsStale
from ca.revocation.lists import Timestamp, digest, sign_timestamp
from grants.model import Right
from rossec import clock
from rossec.clock import Clock, counter
from rossec.master.server.server import MasterServer
from rossec.node import Node
from rossec.participant import membership
from rossec.participant.authorized import STALE_GRACE
from rossec.ros.names import MASTER, REVOCATION_UPDATE
from tests.rossec.sidecar.program import Program, sidecar
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, wait_closed
from tests.support.attacker import EVE, credentials, fields_for, send_header, signed
from tests.support.caller import caller
from tests.support.fleet import SECURE, environment, program
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness, undisturbed, until

HOUR: Final = 3600
LIFE: Final = 60  # seconds of a grant
UNTIL_STALE: Final = 30 + STALE_GRACE


class ClockControl:
    """Sets the host's clock."""

    def __init__(self) -> None:
        self.set = 0.0  # by how much
        self.passed = 0.0  # seconds that need no waiting
        self.clock = Clock(lambda: time.time() + self.set + self.passed, lambda: counter()() + self.passed)


@pytest.fixture
def hand(monkeypatch: pytest.MonkeyPatch) -> ClockControl:
    hand = ClockControl()
    monkeypatch.setattr(clock, "HOST", hand.clock)
    return hand


async def stop_master(site: Site) -> MasterServer:
    """End the master: no list is confirmed any more."""
    assert site.master is not None
    await site.master.close()
    return site.master


@pytest.mark.attack("clock-set-back")
async def test_a_connection_of_a_node_ends_with_its_grant(site: Site, hand: ClockControl) -> None:
    site.publish("/robot", TOPIC, lifetime=LIFE)
    site.subscribe("/viewer", TOPIC)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        pose, sight = await robot.publisher(TOPIC, POSE), await viewer.subscriber(TOPIC, POSE)
        await until(lambda: pose.links and sight.links)
        await stop_master(site)
        hand.set = -HOUR
        await asyncio.sleep(2)  # it is seen to be set back
        assert sight.links
        hand.passed = LIFE + 1
        await until(lambda: not sight.links)


@pytest.mark.attack("clock-set-back")
async def test_without_a_master_a_node_is_stale_at_once(
    site: Site, witness: Witness, hand: ClockControl
) -> None:
    site.subscribe(EVE, TOPIC)
    fields = fields_for(EVE, TOPIC, [signed(site)])
    assert (await send_header(witness.topic_port, credentials(site), fields, 2000)).after
    revocations = witness.robot.revocations
    await stop_master(site)
    revocations.check_fresh(clock.now())
    hand.set = -HOUR
    await until(lambda: _is_stale(revocations.check_fresh))
    heard = await send_header(witness.topic_port, credentials(site), fields)
    assert "is not confirmed by the master" in heard.error


@pytest.mark.attack("clock-set-back")
async def test_without_a_master_a_connection_of_a_node_ends_when_stale(
    site: Site, hand: ClockControl
) -> None:
    site.publish("/robot", TOPIC)
    site.subscribe("/viewer", TOPIC)
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        pose, sight = await robot.publisher(TOPIC, POSE), await viewer.subscriber(TOPIC, POSE)
        await until(lambda: pose.links and sight.links)
        await stop_master(site)
        hand.set = -HOUR
        hand.passed = UNTIL_STALE - 20
        await asyncio.sleep(2)
        assert pose.links, "those that stand are not cut before their time"
        hand.passed = UNTIL_STALE + 1
        await until(lambda: not pose.links)
        await until(lambda: not sight.links)


def _is_fresh(node: Node) -> bool:
    return not _is_stale(node.revocations.check_fresh)


def _is_stale(check: Callable[[int], None]) -> bool:
    try:
        check(clock.now())
    except RevocationsStale:
        return True
    return False


@pytest.fixture
async def pair(tmp_path: Path) -> AsyncIterator[SidecarPair]:
    site = Site(tmp_path / "sidecars")
    site.publish("/talker", "/word", lifetime=LIFE)
    site.subscribe("/listener", "/word")
    async with (
        site.running(),
        sidecar(site) as near,
        sidecar(site) as far,
        Program("/talker", near) as talker,
        Program("/listener", far) as listener,
    ):
        yield SidecarPair(site, near, far, talker, listener)


@pytest.mark.attack("clock-set-back")
async def test_a_connection_of_a_sidecar_ends_with_its_grant(pair: SidecarPair, hand: ClockControl) -> None:
    stream, source = await connect(pair)
    await stop_master(pair.site)
    hand.set, hand.passed = -HOUR, LIFE + 1
    await wait_closed(stream)
    await wait_closed(source)


HANDLED: Final = (
    """
import sys, threading, time
import rossec.clock
hand = [0.0, 0.0]
rossec.clock.HOST = rossec.clock.Clock(
    lambda: time.time() + hand[0] + hand[1], lambda: rossec.clock.counter()() + hand[1]
)
def obey():
    for line in sys.stdin:
        hand[:] = map(float, line.split())
threading.Thread(target=obey, daemon=True).start()
"""
    + SECURE
    + """
import rospy
from std_msgs.msg import String
rospy.init_node("viewer")
rospy.Subscriber("/words", String, lambda message: print("HEARD", message.data, flush=True))
rospy.spin()
"""
)


@pytest.mark.ros
@pytest.mark.attack("clock-set-back")
async def test_a_connection_of_rospy_ends_with_its_grant(site: Site, tmp_path: Path) -> None:
    site.publish("/robot", "/words", lifetime=LIFE)
    site.subscribe("/viewer", "/words")
    async with site.node("/robot") as robot:
        words = await robot.publisher("/words", "std_msgs/String", latch=True)
        words.publish(words.create(data="still"))
        async with program(environment(site, tmp_path), HANDLED, told=True) as viewer:
            await viewer.read_until("HEARD still")
            await stop_master(site)
            await viewer.tell(f"{-HOUR} 0")
            await viewer.read_until("the host's clock went back")
            await viewer.tell(f"{-HOUR} {LIFE + 1}")
            expired = "(/words): its grant or its certificate has expired"
            await viewer.read_until(f"closed the connection with /robot {expired}")


@pytest.mark.attack("clock-set-back")
async def test_a_master_does_not_restore_expired_rights(site: Site, hand: ClockControl) -> None:
    right = Right.PARAM_SET
    site.grant(EVE, right, "/eve/p", lifetime=LIFE)
    async with caller(site, EVE, {}) as eve:
        assert (await eve("setParam", "/eve/p", 1))[0] == 1
        hand.passed = LIFE + 1
        assert "param-set" in await eve.refused("setParam", "/eve/p", 2)
        hand.set = -HOUR
        assert "param-set" in await eve.refused("setParam", "/eve/p", 2)


@pytest.mark.attack("clock-set-back")
async def test_a_whole_site_set_back_continues(
    site: Site, hand: ClockControl, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """An attacker that forges NTP gains nothing, and ends no connection."""
    monkeypatch.setattr(membership, "HEARTBEAT", 0.2)
    async with undisturbed(site) as witness:
        before = clock.now()
        hand.set = -HOUR
        await until(lambda: caplog.text.count("the host's clock went back") >= 2)
        await witness.goes_on()
        for node in (witness.robot, witness.viewer):
            await until(partial(_is_fresh, node))
        assert clock.now() >= before


@pytest.mark.attack("clock-set-back")
async def test_a_wrong_clock_may_be_corrected_with_the_master(
    site: Site, hand: ClockControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The node's host was an hour ahead; the master's was not."""
    monkeypatch.setattr(membership, "HEARTBEAT", 0.2)
    assert site.master is not None
    site.master.state.clock = time.time
    site.enroll("/robot")
    async with site.node("/robot") as robot:
        hand.set = HOUR
        await until(lambda: _is_stale(robot.revocations.check_fresh))
        hand.set = 0
        await until(lambda: _is_fresh(robot))
        assert clock.now() == pytest.approx(time.time(), abs=5)


@pytest.mark.attack("clock-set-back")
async def test_a_delayed_update_does_not_correct_the_clock(site: Site, hand: ClockControl) -> None:
    """An update may have been delayed for any time."""
    signer = site.enroll(MASTER).credentials().signer
    async with site.node("/robot") as robot:
        held = robot.revocations.current
        assert held is not None
        then = clock.now() - HOUR
        stamp = sign_timestamp(signer, Timestamp(held.seq, digest(robot.revocations.data), then, 30))
        hand.set = -HOUR
        with pytest.raises(RevocationRefused, match="too old"):
            robot.push_arrived(REVOCATION_UPDATE, (b"", stamp), site.identity(MASTER))
        assert clock.now() >= then + HOUR
