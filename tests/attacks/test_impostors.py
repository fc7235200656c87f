"""A compromised master names false publishers, which a subscriber must refuse (N2, N9)."""

import contextlib
import time
from collections.abc import AsyncIterator, Callable
from typing import Final

import pytest

from ca.encoding import encode
from ca.errors import HintedError
from grants.errors import GrantExpired, GrantForged, GrantMalformed, GrantMissing, GrantNotHeld
from grants.model import Right
from rossec.channel.edhoc.credentials import Credentials
from rossec.demo.intruder import UnverifiedPeer, accept_any
from rossec.errors import ConnectionHeaderRefused, ForeignIdentity
from rossec.net.aio import SecureStream, WireProtocol, serve
from rossec.net.rpc.calls import serve_calls
from rossec.node import message_type
from rossec.participant.access import FIELD
from rossec.ros import tcpros
from rossec.ros.names import MASTER
from tests.support.attacker import EVE, HOST, call, credentials, flip, signed
from tests.support.contexts import unlimited
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness, until

PUBLISH: Final = Right.PUBLISH
Make = Callable[[Site], bytes]


def answer(grants: list[bytes], **changes: str) -> dict[str, str | bytes]:
    """The connection header of a publisher."""
    kind = message_type(POSE)
    return {
        "callerid": EVE,
        "topic": TOPIC,
        "type": kind.name,
        "md5sum": kind.md5sum,
        FIELD: encode(list(grants)),
        **changes,
    }


@contextlib.asynccontextmanager
async def impostor(own: Credentials, fields: dict[str, str | bytes]) -> AsyncIterator[str]:
    """A node that sends each caller `fields` and a message at once; its API URI."""
    kind = message_type(POSE)
    lie = tcpros.frame(bytes(kind.serialize(kind.create())))

    async def topic(stream: SecureStream[UnverifiedPeer]) -> None:
        await stream.receive()
        await stream.send(tcpros.encode(fields), lie)
        await stream.wait_ended()

    async def where(method: str, params: tuple[object, ...], peer: UnverifiedPeer) -> object:
        return [1, "", ["TCPROS", HOST, server.port]]

    async def slave(stream: SecureStream[UnverifiedPeer]) -> None:
        await serve_calls(stream, where)

    async with (
        serve(topic, HOST, 0, unlimited(own, accept_any)) as server,
        serve(slave, HOST, 0, unlimited(own, accept_any), WireProtocol.HTTP) as api,
    ):
        yield f"http://{HOST}:{api.port}/"


async def led(site: Site, witness: Witness, uri: str) -> HintedError:
    """Let the master name `uri` besides the true publisher; returns why the viewer refuses it."""
    both = [witness.robot.uri, uri]
    told = await call(witness.viewer.uri, credentials(site, MASTER), "publisherUpdate", MASTER, TOPIC, both)
    assert told == [1, "", 0]
    refusals = witness.subscriber.refusals
    await until(lambda: len(refusals) > 0)
    assert len(witness.subscriber.links) == 1
    return refusals[0]


CASES: Final[list[tuple[str, Make, type[HintedError]]]] = [
    ("may subscribe", signed, GrantMissing),
    ("another topic", lambda s: signed(s, right=PUBLISH, pattern="/robot/scan"), GrantMissing),
    ("another key", lambda s: signed(s, right=PUBLISH, holder=s.identity("/robot").thumbprint), GrantNotHeld),
    (
        "expired",
        lambda s: signed(s, right=PUBLISH, not_before=1, expires=int(time.time()), cap=1 << 31),
        GrantExpired,
    ),
    ("signed by a node", lambda s: signed(s, credentials(s).signer, right=PUBLISH), GrantForged),
    ("tampered", lambda s: flip(signed(s, right=PUBLISH), -1), GrantForged),
    ("no grant", lambda _: b"", GrantForged),
    ("cut off", lambda s: signed(s, right=PUBLISH)[:-1], GrantMalformed),
]


@pytest.mark.attack("false-publisher")
@pytest.mark.parametrize(("make", "kind"), [c[1:] for c in CASES], ids=[c[0] for c in CASES])
async def test_a_publisher_without_the_right_is_refused(
    site: Site, witness: Witness, make: Make, kind: type[HintedError]
) -> None:
    async with impostor(credentials(site), answer([make(site)])) as uri:
        assert type(await led(site, witness, uri)) is kind


@pytest.mark.attack("false-publisher")
async def test_a_publisher_without_grants_is_refused(site: Site, witness: Witness) -> None:
    fields = answer([])
    del fields[FIELD]
    async with impostor(credentials(site), fields) as uri:
        assert type(await led(site, witness, uri)) is GrantMissing


@pytest.mark.attack("false-publisher")
async def test_a_publisher_with_the_name_of_another_is_refused(site: Site, witness: Witness) -> None:
    fields = answer(site.enroll("/robot").grants(), callerid="/robot")
    async with impostor(credentials(site), fields) as uri:
        assert type(await led(site, witness, uri)) is ConnectionHeaderRefused


@pytest.mark.attack("false-publisher")
@pytest.mark.parametrize("change", [{"topic": "/other"}, {"md5sum": "0" * 32}, {"error": "go"}])
async def test_a_publisher_with_a_malformed_answer_is_refused(
    site: Site, witness: Witness, change: dict[str, str]
) -> None:
    async with impostor(credentials(site), answer([signed(site, right=PUBLISH)], **change)) as uri:
        assert type(await led(site, witness, uri)) is ConnectionHeaderRefused


@pytest.mark.attack("false-publisher")
async def test_a_publisher_of_another_authority_is_refused(site: Site, witness: Witness) -> None:
    other = Site(site.root.parent / "other", site.anchor.domain)
    fields = answer([signed(other, right=PUBLISH)])
    async with impostor(credentials(other), fields) as uri:
        refused = await led(site, witness, uri)
    assert type(refused) is ForeignIdentity


@pytest.mark.attack("false-publisher")
async def test_a_publisher_with_the_right_is_accepted(site: Site, witness: Witness) -> None:
    """The control: the others are refused for their flaw only."""
    async with impostor(credentials(site), answer([signed(site, right=PUBLISH)])) as uri:
        both = [witness.robot.uri, uri]
        own = credentials(site, MASTER)
        await call(witness.viewer.uri, own, "publisherUpdate", MASTER, TOPIC, both)
        await until(lambda: len(witness.subscriber.links) == 2)
        assert not witness.subscriber.refusals
        # Its one message bears the number 0, which the robot has used already.
        await until(lambda: witness.seen.count(0) == 2)
        witness.seen.reverse()
        witness.seen.remove(0)
        witness.seen.reverse()
