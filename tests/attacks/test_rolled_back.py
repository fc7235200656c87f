"""A master that was set back to an old list: nodes with a newer one send it.

Its home was restored from a backup, or the old file was put there. Nodes with the newer list
refuse the old one; but a node that has none yet would accept it, and serve a revoked key.
"""

import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import AbstractAsyncContextManager
from pathlib import Path

import pytest

from ca.errors import Revoked
from rossec.ros.names import MASTER, parse_uri
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.attacker import EVE, credentials, expect_refused, fields_for, listen, send_header
from tests.support.caller import caller
from tests.support.fleet import SECURE, environment, program
from tests.support.site import Site
from tests.support.witness import until

ROBOT, WORDS, TYPE = "/robot", "/fresh/words", "std_msgs/String"
ROSPY = SECURE + "import rospy\nrospy.init_node('robot')\nprint('READY', flush=True)\nrospy.spin()\n"


@contextlib.asynccontextmanager
async def built_in(site: Site, _: Path) -> AsyncIterator[None]:
    async with site.node(ROBOT):
        yield


@contextlib.asynccontextmanager
async def in_sidecar(site: Site, _: Path) -> AsyncIterator[None]:
    async with sidecar(site) as near, Program(ROBOT, near) as robot:
        await robot.ask(robot.master_uri, "getPid")
        yield


@contextlib.asynccontextmanager
async def in_rospy(site: Site, folder: Path) -> AsyncIterator[None]:
    async with program(environment(site, folder), ROSPY) as robot:
        await robot.read_until("READY")
        yield


Knower = Callable[[Site, Path], AbstractAsyncContextManager[None]]


@pytest.mark.attack("rolled-back-master")
@pytest.mark.parametrize("knower", [built_in, in_sidecar, pytest.param(in_rospy, marks=pytest.mark.ros)])
async def test_a_master_set_back_gets_the_newer_list_from_nodes(
    tmp_path: Path, knower: Knower, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    listen(caplog)
    site = Site(tmp_path / "site")
    home, master = site.enroll(ROBOT), site.enroll(MASTER)
    allowed = site.subscribe(EVE, WORDS)
    site.publish("/fresh", WORDS)
    old = site.authority.store.newest_list()
    assert old is not None
    async with site.running(), knower(site, tmp_path):
        newest = site.revoke(site.identity(EVE).thumbprint)
        async with caller(site, "/carrier") as carrier:
            await carrier("rossec.updateRevocations", newest)
        await until(lambda: home.load_revocations() == newest)
        assert site.master is not None
        _, port = parse_uri(site.master.uri)
        await site.master.close()
        (master.path / "revocations.cose").write_bytes(old)
        monkeypatch.setattr(site.authority.store, "newest_list", lambda: old)
        await site.start_master(port)
        await until(lambda: master.load_revocations() == newest)
        async with site.node("/fresh") as fresh:
            words = await fresh.publisher(WORDS, TYPE, latch=True)
            words.publish(words.create(data="hello"))
            fields = fields_for(EVE, WORDS, [allowed])
            heard = await send_header(fresh.topic_endpoint()[1], credentials(site), fields)
            expect_refused(heard, caplog, Revoked, "revoked")
            assert fresh.revocations.data == newest
