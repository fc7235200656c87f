"""The channel as one identity speaks it: who is met, and where it listens."""

import socket
from pathlib import Path

import pytest

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.net.aio import SecureStream
from rossec.sidecar import loopback_port
from rossec.sidecar.core.endpoints import Endpoint
from rossec.sidecar.loopback_port import free_port
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.site import Site
from tests.support.witness import until


async def nothing(_: SecureStream[Identity]) -> None:
    """Serves nobody."""


@pytest.fixture
def site(tmp_path: Path) -> Site:
    site = Site(tmp_path / "site")
    for name in ("/robot", "/viewer"):
        site.enroll(name)
    return site


async def begun(near: Sidecar, name: str) -> None:
    """The identity meets the master, and knows what is revoked."""
    async with Program(name, near) as program:
        await program.ask(near.uri, "getPid")


async def test_whoever_answers_is_judged_before_it_is_spoken_to(site: Site) -> None:
    async with site.running(), sidecar(site) as near:
        robot, viewer = near._agent_for("/robot"), near._agent_for("/viewer")
        await begun(near, "/robot")
        await begun(near, "/viewer")
        server = robot._connector.listen(nothing, "127.0.0.1", WireProtocol.HTTP)
        place = Endpoint(WireProtocol.HTTP, "127.0.0.1", server.port)
        stream = await viewer.dial(place)
        assert stream.peer.name == "/robot"
        stream.abort("enough")
        key = site.identity("/robot").thumbprint
        membership = viewer._membership
        await membership._session.call("rossec.updateRevocations", site.revoke(key))
        await until(lambda: key in membership._revocations.entries, within=20)
        with pytest.raises(HangUp, match="revoked"):
            await viewer.dial(place)
        await server.close()


async def test_a_port_that_is_taken_meanwhile(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another is tried; where none is free the reason is told."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        ports = [taken.getsockname()[1]]
        monkeypatch.setattr(
            loopback_port, "free_port", lambda: ports.pop() if ports else free_port()
        )
        async with sidecar(site) as near:
            robot = near._agent_for("/robot")._connector
            server = robot.listen(nothing, "127.0.0.1", WireProtocol.HTTP)
            assert server.port != taken.getsockname()[1]
            await server.close()
            monkeypatch.setattr(loopback_port, "free_port", lambda: taken.getsockname()[1])
            with pytest.raises(OSError, match="in use"):
                robot.listen(nothing, "127.0.0.1", WireProtocol.HTTP)
