"""A visitor's rights end in the other forms of a node as in the built-in one: rospy, a sidecar."""

import contextlib
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

import pytest

from ca.errors import HintedError
from ca.revocation.lists import MAX_AGE, Timestamp, digest, open_list, sign_timestamp
from grants.model import Right
from rossec.channel.opening import WireProtocol
from rossec.net.aio import SecureStream, connect
from rossec.net.rpc.calls import RpcClient
from rossec.node import Node
from rossec.ros import tcpros
from rossec.ros.names import MASTER
from tests.attacks.test_existence import ports
from tests.rossec.sidecar.program import Program, sidecar
from tests.support import trust
from tests.support.attacker import EVE, HOST, call, credentials, dial, fields_for
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.victim import STATE, attacked

DOMAIN: Final = "hospital"
ENDS: Final = ("hospital", "home", "removal")
within_a_second = pytest.mark.parametrize("by", ENDS)


class Stay:
    """Eve of a hospital, who reads a topic of a node of the home."""

    def __init__(self, home: Site, hospital: Site, helper: Node, port: int, topic: str) -> None:
        self.home, self.hospital, self.helper = home, hospital, helper
        self.port, self.topic = port, topic

    async def list(self, data: bytes) -> None:
        await self.helper._membership.session.call("rossec.updateDomains", data)

    def word(self, data: bytes) -> None:
        signer = self.hospital.enroll(MASTER).credentials()
        seq = open_list(data, self.hospital.anchor.public_key).seq
        stamp = Timestamp(seq, digest(data), self.hospital.now(), MAX_AGE)
        assert self.home.master is not None
        self.home.master.effects.take_foreign(
            DOMAIN, data, sign_timestamp(signer.signer, stamp), signer.chain
        )

    async def begin(self) -> SecureStream[Any]:
        """Connect as soon as the node has heard of the hospital, and receive a message."""
        data = self.hospital.authority.store.newest_list()
        assert data is not None
        await self.list(trust.accept(self.home, self.hospital))
        self.word(data)
        grant = trust.share(self.home, self.hospital, EVE, Right.SUBSCRIBE, self.topic)
        own = unlimited(credentials(self.hospital), self.home.anchor.verify)
        end = time.monotonic() + 20
        while True:
            with contextlib.suppress(HintedError):
                stream = await connect(HOST, self.port, own)
                await stream.send(tcpros.encode(fields_for(EVE, self.topic, [grant])))
                if b"error=" not in await stream.receive():
                    return stream
            assert time.monotonic() < end, "it was never let in"

    async def end(self, stream: SecureStream[Any], by: str) -> None:
        """End the visit; Eve hears nothing a second later."""
        if by == "removal":
            await self.list(trust.remove(self.home, DOMAIN))
        elif by == "home":
            data = self.home.revoke(self.hospital.identity(EVE).thumbprint)
            await self.helper._membership.session.call("rossec.updateRevocations", data)
        else:
            self.word(self.hospital.revoke(self.hospital.identity(EVE).thumbprint))
        began = time.monotonic()
        with contextlib.suppress(HintedError):
            while await stream.receive():
                assert time.monotonic() - began < 2
        stream.abort("it is over")

    async def check_master_is_none(self, uri: str) -> None:
        """The hospital's master, which is admitted, controls nothing."""
        client = RpcClient(await dial(uri, credentials(self.hospital, MASTER)))
        for method, *params in (
            ("shutdown", "now"),
            ("publisherUpdate", self.topic, []),
            ("rossec.domainsUpdate", b""),
            ("rossec.foreignRevocationUpdate", DOMAIN, b"", b"", []),
        ):
            answer: Any = await client.call(str(method), MASTER, *params)
            assert answer[0] == -1
        await client.close()


@pytest.mark.ros
@pytest.mark.attack("foreign-node")
@within_a_second
async def test_a_visit_at_rospy_ends_within_a_second(tmp_path: Path, by: str) -> None:
    async with attacked(tmp_path) as victim:
        hospital = Site(tmp_path / "hospital", DOMAIN)
        stay = Stay(victim.site, hospital, victim.viewer, victim.port, STATE)
        stream = await stay.begin()
        await stay.check_master_is_none(victim.uri)
        await stay.end(stream, by)
        await victim.goes_on()


@pytest.fixture
async def helper(site: Site) -> AsyncIterator[Node]:
    async with site.node("/helper") as node:
        yield node


@pytest.mark.attack("foreign-node")
@within_a_second
async def test_a_visit_at_a_sidecar_ends_within_a_second(
    site: Site, helper: Node, tmp_path: Path, by: str
) -> None:
    topic = "/robot2/word"
    site.publish("/robot2", "/**")
    async with sidecar(site) as near, Program("/robot2", near) as robot:
        await robot.register("registerPublisher", topic, "std_msgs/String")
        [api] = ports(near, WireProtocol.HTTP)
        uri = f"http://{HOST}:{api}/"
        own = credentials(site)
        offer: Any = await call(uri, own, "requestTopic", EVE, topic, [["TCPROS"]])
        stay = Stay(site, Site(tmp_path / "hospital", DOMAIN), helper, offer[2][2], topic)
        stream = await stay.begin()
        await stay.check_master_is_none(uri)
        await stay.end(stream, by)
