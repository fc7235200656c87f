"""The secure channel of one identity: peers and listening ports."""

import socket
from pathlib import Path

import pytest

from ca.certificates import Identity
from rossec.channel.opening import WireProtocol
from rossec.errors import HangUp
from rossec.host import local_ports
from rossec.host.local_ports import free_port
from rossec.net.aio import SecureStream
from rossec.sidecar.core.layers import ListeningAddress
from rossec.sidecar.server import Sidecar
from tests.rossec.sidecar.program import Program, sidecar
from tests.support.site import Site
from tests.support.witness import until


async def ignore(_: SecureStream[Identity]) -> None:
    """Serve nothing."""


@pytest.fixture
def site(tmp_path: Path) -> Site:
    site = Site(tmp_path / "site")
    for name in ("/robot", "/viewer"):
        site.enroll(name)
    return site


async def start_agent(running: Sidecar, name: str) -> None:
    """Start the agent, so that it has revocation data."""
    async with Program(name, running) as program:
        await program.ask(running.uri, "getPid")


async def test_a_revoked_peer_is_refused_before_anything_is_sent(
    site: Site, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.participant.membership.HEARTBEAT", 0.5)
    async with site.running(), sidecar(site) as running:
        robot, viewer = running._agent_for("/robot"), running._agent_for("/viewer")
        await start_agent(running, "/robot")
        await start_agent(running, "/viewer")
        server = robot._connector.listen(ignore, "127.0.0.1", WireProtocol.HTTP)
        endpoint = ListeningAddress(WireProtocol.HTTP, "127.0.0.1", server.port)
        stream = await viewer.dial(endpoint)
        assert stream.peer.name == "/robot"
        stream.abort("enough")
        key = site.identity("/robot").thumbprint
        membership = viewer._membership
        await membership.session.call("rossec.updateRevocations", site.revoke(key))
        await until(lambda: key in membership._identity.revocations.entries, within=20)
        with pytest.raises(HangUp, match="revoked"):
            await viewer.dial(endpoint)
        await server.close()


async def test_another_port_is_bound_if_one_is_taken(site: Site, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another port is tried; if none is free, the error is raised."""
    with socket.create_server(("127.0.0.1", 0)) as taken:
        ports = [taken.getsockname()[1]]
        monkeypatch.setattr(local_ports, "free_port", lambda: ports.pop() if ports else free_port())
        async with sidecar(site) as running:
            robot = running._agent_for("/robot")._connector
            server = robot.listen(ignore, "127.0.0.1", WireProtocol.HTTP)
            assert server.port != taken.getsockname()[1]
            await server.close()
            monkeypatch.setattr(local_ports, "free_port", lambda: taken.getsockname()[1])
            with pytest.raises(OSError, match="in use"):
                robot.listen(ignore, "127.0.0.1", WireProtocol.HTTP)
