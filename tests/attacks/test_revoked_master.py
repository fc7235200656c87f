"""A master that is revoked, or whose intermediate is, and that nodes are redirected to.

Its certificate still verifies. It confirms an old list as the newest, or reports an earlier time.
"""

import secrets
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from ca.authority import Authority
from ca.certificates import build_intermediate_request, from_pem
from ca.errors import RevocationsStale
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from ca.revocation.lists import Timestamp, digest, sign_timestamp
from rossec import clock
from rossec.authority.renewals import sign_intermediate
from rossec.authority.signing import SigningAuthority
from rossec.home import NodeHome
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import serve_calls
from rossec.node import Node
from rossec.participant import membership
from rossec.ros.names import MASTER
from tests.attacks.test_clock import HOUR, ClockControl, hand, stop_master
from tests.attacks.test_intermediates import send_list
from tests.support.contexts import unlimited
from tests.support.site import DAY, Site
from tests.support.witness import until

__all__ = ["hand"]

STOPS: Final = 30 + 5  # seconds until a confirmation expires


@pytest.fixture
def below(site: Site, tmp_path: Path) -> NodeHome:
    """A master below a stolen intermediate."""
    signer = KeySigner(generate())
    request = build_intermediate_request(signer, site.anchor.domain)
    _, bundle = sign_intermediate(site.authority, request, site.now(), may_enroll=True)
    der, root = from_pem(bundle)
    host = SigningAuthority(Authority(signer, root, der), site.authority.store, site.root)
    home = NodeHome.of(tmp_path / "elsewhere", MASTER)
    home.create_request(site.anchor.domain)
    leaf = host.authority.issue(home.request(), now=site.now(), serial=secrets.randbits(127), lifetime=DAY)
    home.install(host.bundle(leaf), site.now())
    return home


class Notifications:
    """The notifications the node got, and how often."""

    times = 0


@asynccontextmanager
async def instead_of_the_master(
    site: Site, home: NodeHome, news: Callable[[], list[bytes]]
) -> AsyncIterator[Notifications]:
    """The real one cannot be reached, and this one answers at its address."""
    port = (await stop_master(site)).port
    told = Notifications()

    def answer(method: str, params: tuple[object, ...], _: object) -> list[object]:
        if method != "rossec.revocationsSince":
            return [0, "no", 0]
        told.times += 1
        return [1, "", news()]

    async def handle(stream: SecureStream[Any]) -> None:
        await serve_calls(stream, answer)

    server = serve(
        handle, "127.0.0.1", port, unlimited(home.credentials(), site.anchor.verify), WireProtocol.HTTP
    )
    try:
        yield told
    finally:
        await server.close()


def stamped(home: NodeHome, node: Node, issued: int) -> bytes:
    held = node.revocations.current
    assert held is not None
    word = Timestamp(held.seq, digest(node.revocations.data), issued, 30)
    return sign_timestamp(home.credentials().signer, word)


@pytest.mark.attack("revoked-master")
async def test_a_master_below_a_revoked_intermediate_confirms_nothing(
    site: Site, below: NodeHome, hand: ClockControl
) -> None:
    [intermediate] = below.identity(site.now()).issuers
    site.enroll("/robot")
    async with site.node("/robot") as robot:
        data = site.revoke(intermediate)
        await send_list(site, data)
        await until(lambda: robot.revocations.data == data)
        async with instead_of_the_master(
            site, below, lambda: [b"", stamped(below, robot, clock.now())]
        ) as told:
            hand.passed = STOPS
            await until(lambda: told.times >= 2)
            with pytest.raises(RevocationsStale):
                robot.revocations.check_fresh(clock.now())


@pytest.mark.attack("revoked-master")
async def test_a_revoked_master_does_not_correct_the_clock(
    site: Site, below: NodeHome, hand: ClockControl, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a list that is refused for another reason, and a host's clock that is set."""
    monkeypatch.setattr(membership, "HEARTBEAT", 0.2)
    site.enroll("/robot")
    async with site.node("/robot") as robot:
        data = site.revoke(below.identity(site.now()).thumbprint)
        await send_list(site, data)
        await until(lambda: robot.revocations.data == data)
        before = clock.now()
        async with instead_of_the_master(
            site, below, lambda: [b"no list", stamped(below, robot, before - HOUR)]
        ) as told:
            hand.set = -HOUR
            await until(lambda: told.times >= 2)
            assert clock.now() >= before
