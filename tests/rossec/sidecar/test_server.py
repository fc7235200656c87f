"""The loopback master: which identity a call is made with."""

import pytest

from rossec.ros.xmlrpc import Fault
from tests.rossec.sidecar.conversation import Pair
from tests.rossec.sidecar.program import Program, sidecar


async def test_a_program_that_may_not_is_told_why(pair: Pair) -> None:
    site = pair.site
    async with Program("/stranger", pair.far) as stranger:
        answer = await stranger.ask(stranger.master_uri, "getPid")
        assert isinstance(answer, list)
        assert "has no identity here (enroll it: rossec node request /stranger" in answer[1]
        site.enroll("/stranger")
        await pair.talker.register("registerPublisher", "/word", "std_msgs/String")
        known = await pair.listener.register("registerSubscriber", "/word", "std_msgs/String")
        assert isinstance(known, list)
        # It knows where the talker is, and asks there without the master (attack N5).
        agent = pair.far._agent_for("/stranger")
        remote = pair.far._agent_for("/listener").tenant.doors
        place = next(iter(remote._imported.values()))
        answer = await stranger.ask(stranger.master_uri, "getPid")
        door = f"http://127.0.0.1:{agent.bring(place)}/"
        _, fields = await stranger.subscribe(door, "/word")
        assert b"no grant" in fields["error"]
    assert not pair.talker.connections


async def test_one_identity_for_all_and_empty_multicalls(pair: Pair) -> None:
    async with sidecar(pair.site, each=False, identity="/listener") as one:
        program = Program("/anything", one)
        assert await program.ask(one.uri, "getUri") == [1, "", one.uri]
        client = Program("/x", one)
        with pytest.raises(Fault, match="caller_id"):
            await client.ask(one.uri, "system.multicall", 1)
        await program.close()
        await client.close()
    async with sidecar(pair.site, identity="/listener") as default:
        program = Program("/not/enrolled", default)
        assert await program.ask(default.uri, "getUri") == [1, "", default.uri]
        await program.close()
