"""kill -9 of the master under load: nodes register again, no acknowledged change is lost."""

import asyncio
import contextlib
from pathlib import Path

import pytest

from grants.model import Right
from rossec.errors import AnswerRefused, RossecError
from rossec.net.aio import WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.node import Node
from tests.support.contexts import unlimited
from tests.support.masterprocess import MasterProcess, master_process
from tests.support.witness import POSE, TOPIC, until

T = "std_msgs/String"


async def client_of(master: MasterProcess, name: str) -> RpcClient:
    """A control connection with the grants of `name`."""
    home = master.site.enroll(name)
    stream = await connect(
        "127.0.0.1", master.port, unlimited(home.credentials(), home.anchor().verify), WireProtocol.HTTP
    )
    client = RpcClient(stream)
    await client.ask("rossec.presentGrants", name, home.grants())
    return client


async def load(client: RpcClient, acknowledged: list[int]) -> None:
    """Set a parameter to increasing numbers until the master is gone."""
    with contextlib.suppress(RossecError):
        for number in range(10**9):
            await client.ask("setParam", "/load", "/load/number", number)
            acknowledged.append(number)


async def test_nodes_recover_and_nothing_promised_is_lost(tmp_path: Path) -> None:
    async with contextlib.AsyncExitStack() as stack:
        master = await stack.enter_async_context(master_process(tmp_path / "site"))
        site = master.site
        site.publish("/robot", TOPIC)
        site.subscribe("/viewer", TOPIC)
        site.grant("/load", Right.PARAM_SET | Right.PARAM_GET, "/load/**")
        site.grant("/load", Right.GRAPH, "/**")
        site.subscribe("/eve", TOPIC)
        await master.start()
        robot = await stack.enter_async_context(Node("/robot", environ=master.environ))
        viewer = await stack.enter_async_context(Node("/viewer", environ=master.environ))
        pose = await robot.publisher(TOPIC, POSE)
        await viewer.subscriber(TOPIC, POSE)
        await pose.wait_for_subscribers()
        older = site.authority.store.newest_list()
        revoked = site.revoke(site.identity("/eve").thumbprint)
        await robot._membership.session.call("rossec.updateRevocations", revoked)
        acknowledged: list[int] = []
        first = await client_of(master, "/load")
        state = await first.ask("getSystemState", "/load")
        async with asyncio.TaskGroup() as group:
            group.create_task(load(first, acknowledged))
            await until(lambda: len(acknowledged) > 200, within=30)
            await master.kill()
        await master.start()

        again = await client_of(master, "/load")
        number = await again.ask("getParam", "/load", "/load/number")
        assert number in (acknowledged[-1], acknowledged[-1] + 1)  # the last call may have no answer
        async with asyncio.timeout(60):
            while await again.ask("getSystemState", "/load") != state:  # noqa: ASYNC110 - asking
                await asyncio.sleep(0.05)
        await until(lambda: len(pose.links) == 1, within=30)
        with pytest.raises(RossecError):
            await client_of(master, "/eve")
        with pytest.raises(AnswerRefused, match="older"):  # nor is the previous list accepted again
            await again.ask("rossec.updateRevocations", "/load", older)
        await again.close()
