"""Programs of one identity behind one sidecar reach each other and themselves."""

from pathlib import Path

import pytest

from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.sidecar.core.layers import parse_endpoint
from tests.rossec.sidecar.program import Program, sidecar, string_message
from tests.support.site import Site

SERVICE, TOPIC = "/say", "/word"


@pytest.fixture
def site(tmp_path: Path) -> Site:
    return Site(tmp_path / "site")


def grant_everything(site: Site, name: str, *, wildcard: bool = False) -> None:
    site.enroll(name, wildcard=wildcard)
    site.publish(name, TOPIC)
    site.subscribe(name, TOPIC)
    site.grant(name, Right.PROVIDE, SERVICE)
    site.grant(name, Right.CALL, SERVICE)


async def provide(program: Program) -> None:
    answer = await program.ask(
        program.master_uri,
        "registerService",
        SERVICE,
        f"rosrpc://127.0.0.1:{program.topics.port}",
        program.uri,
    )
    assert isinstance(answer, list)
    assert answer[0] == 1, answer


async def call(program: Program) -> bytes:
    """What the service echoes, through the port in the master's answer."""
    found = await program.ask(program.master_uri, "lookupService", SERVICE)
    assert isinstance(found, list)
    endpoint = parse_endpoint(found[2], WireProtocol.TCPROS)
    assert endpoint is not None
    assert endpoint.port != program.topics.port, "around the channel, and around what its grants say"
    stream, answer = await program.call(found[2], SERVICE)
    assert "error" not in answer, answer
    await stream.send(b"\4\0\0\0echo")
    receive_bytes = await stream.receive()
    stream.abort()
    return receive_bytes


async def test_a_program_calls_its_own_service(site: Site) -> None:
    grant_everything(site, "/robot")
    async with site.running(), sidecar(site) as running, Program("/robot", running) as robot:
        await provide(robot)
        assert (await call(robot)).endswith(b"echo")


async def test_another_program_of_the_same_identity_calls_the_service(site: Site) -> None:
    grant_everything(site, "/robot")
    async with (
        site.running(),
        sidecar(site, each=False, identity="/robot") as running,
        Program("/robot", running) as robot,
        Program("/rosservice_17", running) as tool,
    ):
        await provide(robot)
        assert (await call(tool)).endswith(b"echo")


async def test_another_node_of_the_same_identity_subscribes(site: Site) -> None:
    grant_everything(site, "/robot", wildcard=True)
    async with (
        site.running(),
        sidecar(site, each=False, identity="/robot") as running,
        Program("/robot", running) as robot,
        Program("/robot_2", running) as other,
    ):
        await robot.register("registerPublisher", TOPIC, "std_msgs/String")
        uris = await other.register("registerSubscriber", TOPIC, "std_msgs/String")
        assert isinstance(uris, list)
        assert uris != [robot.uri], "around the channel"
        stream, answer = await other.subscribe(str(uris[0]), TOPIC)
        assert answer["callerid"] == b"/robot"
        await robot.connected.wait()
        await robot.connections[0].send(string_message("hello"))
        assert (await stream.receive()) == string_message("hello")
        stream.abort()
