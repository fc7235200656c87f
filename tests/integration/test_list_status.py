"""How far a revocation list has come, and who was denied: a real master and real nodes."""

import asyncio
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import AnswerRefused
from rossec.net.rpc.calls import RpcClient
from rossec.node import Node
from tests.support.attacker import credentials, dial
from tests.support.caller import Caller
from tests.support.masterprocess import master_process

POSE = "geometry_msgs/PoseStamped"


@pytest.mark.timeout(240)
async def test_the_authority_learns_when_every_node_has_its_list(tmp_path: Path) -> None:
    async with master_process(tmp_path / "site") as master:
        site = master.site
        site.publish("/robot", "/pose")
        gone = site.subscribe("/doctor", "/pose")
        site.enroll("/eve")
        await master.start()
        office = Caller(site, "/ca", RpcClient(await dial(master.uri, credentials(site, "/ca"))))

        async def ask(method: str) -> Any:
            code, _, value = await office(method)
            assert code == 1
            return value

        async def trust_status(nodes: int, holding: int) -> Any:
            async with asyncio.timeout(60):
                while True:
                    found = await ask("rossec.revocationStatus")
                    if (found["nodes"], found["holding"]) == (nodes, holding):
                        return found
                    await asyncio.sleep(0.05)

        robot, eve, doctor = (
            Node(name, environ=dict(master.environ)) for name in ("/robot", "/eve", "/doctor")
        )
        async with robot, eve, doctor:
            await robot.publisher("/pose", POSE)
            await doctor.subscriber("/pose", POSE)
            with pytest.raises(AnswerRefused):
                await eve.subscriber("/pose", POSE)
            before = await trust_status(3, 3)
            newest = site.revoke(gone)
            assert (await office("rossec.updateRevocations", newest))[2] == 1
            after = await trust_status(3, 3)
            assert after["list"] != before["list"]
            assert after["lacking"] == []
        ((ago, *denied),) = await ask("rossec.recentDenials")
        assert 0 <= ago < 200
        assert denied == ["/eve", int(Right.SUBSCRIBE), "/pose"]
        await trust_status(0, 0)  # nodes that ended are not waited for
        await office.client.close()
