"""An authorized publisher begins a message and does not end it: how much is buffered, how long."""

import contextlib
import itertools
import struct
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path
from typing import Final

import pytest

from grants.model import Right
from rossec.node import Publisher, message_type
from rossec.node.publisher import SubscriberConnection
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.fleet import SECURE, entitle, environment, program
from tests.support.sidecarprogram import subscribed
from tests.support.site import Site
from tests.support.witness import until

FIXED: Final = "geometry_msgs/Twist"  # 48 bytes, and never more
LONG: Final = "sensor_msgs/Image"
TOPIC: Final = "/endless"
WINDOW: Final = 2  # seconds, in place of a minute
MEGABYTE: Final = 1024 * 1024

Form = Callable[[Site, Path, str], AbstractAsyncContextManager[None]]
pytestmark = pytest.mark.attack("endless-unit")


@pytest.fixture
async def site(tmp_path: Path) -> AsyncIterator[Site]:
    site = Site(tmp_path / "site")
    entitle(site, "/mallory", {Right.PUBLISH: (TOPIC,)})
    entitle(site, "/robot", {Right.SUBSCRIBE: (TOPIC,)})
    async with site.running() as site:
        yield site


@pytest.fixture
def hasty(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seconds, not minutes, in this process; ROBOT sets its own."""
    monkeypatch.setattr("rossec.peer_limits.WINDOW", WINDOW)
    monkeypatch.setattr("rossec.peer_limits.STEP", 1)
    monkeypatch.setattr("rossec.net.aio.stream.PATIENCE", 1.0)


@contextlib.asynccontextmanager
async def built_in(site: Site, _directory: Path, kind: str) -> AsyncIterator[None]:
    async with site.node("/robot") as robot:
        await robot.subscriber(TOPIC, kind)
        yield


ROBOT: Final = (
    SECURE
    + f"""
import rospy, sys
import rossec.peer_limits, rossec.inprocess.sockets
from importlib import import_module
rossec.peer_limits.WINDOW = {WINDOW}
rossec.peer_limits.STEP = 1
rossec.inprocess.sockets.PATIENCE = 1.0
package, name = sys.argv[1].split("/")
rospy.init_node("robot")
rospy.Subscriber("{TOPIC}", getattr(import_module(package + ".msg"), name), print)
rospy.spin()
"""
)


@contextlib.asynccontextmanager
async def rospy(site: Site, directory: Path, kind: str) -> AsyncIterator[None]:
    async with program(environment(site, directory / "logs"), ROBOT, kind):
        yield


@contextlib.asynccontextmanager
async def behind_a_sidecar(site: Site, _directory: Path, kind: str) -> AsyncIterator[None]:
    own = message_type(kind)
    fields = {
        "type": kind.encode(),
        "md5sum": own.md5sum.encode(),
        "message_definition": own.definition.encode(),
    }
    async with sidecar(site) as near, Program("/robot", near) as robot:
        stream, _ = await subscribed(robot, TOPIC, fields)
        yield
        stream.abort()


forms = pytest.mark.parametrize(
    "form", [built_in, pytest.param(rospy, marks=pytest.mark.ros), behind_a_sidecar]
)


@contextlib.asynccontextmanager
async def met(
    site: Site, directory: Path, form: Form, kind: str
) -> AsyncIterator[tuple[Publisher, SubscriberConnection]]:
    """Mallory publishes, and the robot has just connected."""
    async with site.node("/mallory") as mallory:
        publisher = await mallory.publisher(TOPIC, kind)
        async with form(site, directory, kind):
            await publisher.wait_for_subscribers()
            (link,) = publisher.links
            yield publisher, link


async def begin(link: SubscriberConnection, size: int) -> None:
    """Send a part of a unit, without its last record."""
    stream = link.stream
    whole = stream.connection.seal_unit(bytes(size + 300_000))
    for record in itertools.islice(whole, size // (256 * 1024)):
        stream.write(record)
        await stream.drain()


@forms
async def test_buffered_bytes_are_limited_by_the_type(site: Site, tmp_path: Path, form: Form) -> None:
    """Before any deadline: 20 MB of a unit are sent where a message has 48 bytes."""
    async with met(site, tmp_path, form, FIXED) as (publisher, link):
        with contextlib.suppress(Exception):  # it may end before all is sent
            await begin(link, 20 * MEGABYTE)
        await until(lambda: link not in publisher.links)


@forms
@pytest.mark.usefixtures("hasty")
async def test_a_unit_that_never_ends_times_out(site: Site, tmp_path: Path, form: Form) -> None:
    async with met(site, tmp_path, form, LONG) as (publisher, link):
        await begin(link, 20 * MEGABYTE)
        await until(lambda: link not in publisher.links)


@pytest.mark.parametrize("form", [built_in, pytest.param(rospy, marks=pytest.mark.ros)])
@pytest.mark.usefixtures("hasty")
async def test_a_message_that_never_ends_times_out(site: Site, tmp_path: Path, form: Form) -> None:
    """Each unit is complete, the message in them is not. Sidecars forward what arrived."""
    async with met(site, tmp_path, form, LONG) as (publisher, link):
        await link.stream.send(struct.pack("<I", 40 * MEGABYTE) + bytes(20 * MEGABYTE))
        await until(lambda: link not in publisher.links)
