"""A stolen leaf after its intermediate is revoked: refused and closed (go-spiffe#383)."""

import secrets
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Final

import pytest

from ca.authority import Authority
from ca.certificates import build_intermediate_request, from_pem
from ca.errors import Revoked
from ca.keys.private_keys import generate
from ca.keys.signing import KeySigner
from grants.model import Restriction, Right
from rossec.authority.renewals import sign_intermediate
from rossec.authority.signing import SigningAuthority
from rossec.errors import ChannelError
from rossec.master.api.dispatch import MAX_BELOW_INTERMEDIATE, MAX_CALLS, MAX_CONNECTIONS
from rossec.net.rpc.calls import CallFailed, RpcClient
from rossec.participant.authorized import STALE_GRACE
from tests.rossec.sidecar.program import Program, sidecar
from tests.rossec.sidecar.sidecar_pair import SidecarPair, connect, wait_closed
from tests.support.attacker import (
    EVE,
    call,
    credentials,
    dial,
    expect_refused,
    fields_for,
    revoke,
    send_header,
    signed,
)
from tests.support.fleet import SECURE, environment, program
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness, until

LIMIT: Final = 2000  # bytes: enough to see that messages come


def below(site: Site, *names: str) -> bytes:
    """Let an intermediate certify these nodes' keys; returns the intermediate's thumbprint."""
    signer = KeySigner(generate())
    request = build_intermediate_request(signer, site.anchor.domain)
    _, bundle = sign_intermediate(site.authority, request, site.now(), may_enroll=True)
    der, root = from_pem(bundle)
    host = SigningAuthority(Authority(signer, root, der), site.authority.store, site.root)
    for name in names:
        identity = site.identity(name)
        leaf = host.authority.reissue(
            identity, identity.public_key, now=site.now(), serial=secrets.randbits(127)
        )
        site.enroll(name).install(host.bundle(leaf), site.now())
        assert site.identity(name).issuers == (host.authority.issuer.thumbprint,)
    return host.authority.issuer.thumbprint


async def send_list(site: Site, data: bytes) -> None:
    """Another node sends the list, or the tree, to the master."""
    assert site.master is not None
    own, method = credentials(site, "/carrier"), "rossec.updateRevocations"
    if site.entries is None:
        await call(site.master.uri, own, method, "/carrier", data)
    else:
        tree = "rossec.updateRevocationTree"
        await call(site.master.uri, own, tree, "/carrier", data, site.entries)


@pytest.mark.attack("revoked-intermediate")
async def test_a_stolen_leaf_after_its_intermediate_is_revoked(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    intermediate = below(site, EVE)
    stolen = site.enroll(EVE).credentials()
    fields = fields_for(EVE, TOPIC, [signed(site)])
    assert (await send_header(witness.topic_port, stolen, fields, LIMIT)).after
    await revoke(site, witness, intermediate)
    heard = await send_header(witness.topic_port, stolen, fields)
    expect_refused(heard, caplog, Revoked, "is revoked")
    assert site.master is not None
    with pytest.raises(ChannelError):
        await call(site.master.uri, stolen, "getPid", EVE)


@pytest.mark.attack("revoked-intermediate")
async def test_its_open_connections_are_closed(site: Site, witness: Witness) -> None:
    site.subscribe(EVE, TOPIC)
    intermediate = below(site, EVE)
    before = set(witness.publisher.links)
    async with site.node(EVE) as eve:
        sight = await eve.subscriber(TOPIC, POSE)
        await until(lambda: len(witness.publisher.links) == len(before) + 1)
        assert sight is not None
        await revoke(site, witness, intermediate)
        await until(lambda: set(witness.publisher.links) == before)
        assert site.master is not None
        master = site.master
        await until(lambda: EVE not in {stream.peer.name for stream in master.state.streams})


WITHIN: Final = STALE_GRACE / 2  # seconds: an update, and not its absence, must end it
KEEP: Final = Restriction(keep_when_stale=True)


@pytest.fixture(params=["list", "tree"])
async def signing(
    request: pytest.FixtureRequest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> AsyncIterator[Site]:
    """A site whose authority signs a list, or a tree as from the 4097th revocation on."""
    site = Site(tmp_path / "site")
    if request.param == "tree":
        monkeypatch.setattr("rossec.authority.signing.MAX_ENTRIES", 0)
        monkeypatch.setattr("rossec.node.subscriber.LONGEST_PAUSE", 0.5)  # a proof at each attempt
        site.revoke(bytes(32))
    async with site.running():
        yield site


@pytest.mark.attack("revoked-intermediate")
@pytest.mark.parametrize("restriction", [None, KEEP], ids=["cut", "keep"])
async def test_a_connection_with_both_ends_below_it_is_closed(
    signing: Site, restriction: Restriction | None
) -> None:
    """Neither may call the master any more, and yet both are notified that the other is revoked."""
    site = signing
    site.grant("/robot", Right.PUBLISH, TOPIC, restriction=restriction)
    site.grant("/viewer", Right.SUBSCRIBE, TOPIC, restriction=restriction)
    intermediate = below(site, "/robot", "/viewer")
    async with site.node("/robot") as robot, site.node("/viewer") as viewer:
        pose = await robot.publisher(TOPIC, POSE)
        sight = await viewer.subscriber(TOPIC, POSE)
        await until(lambda: pose.links and sight.links, 120)
        [link] = pose.links
        assert link.decision.keep_when_stale == (restriction is not None)
        data = site.revoke(intermediate)
        await send_list(site, data)
        await until(lambda: not pose.links, WITHIN)
        await until(lambda: not sight.links, WITHIN)
        nodes = robot, viewer
        await until(lambda: {node.revocations.data for node in nodes} == {data})
        assert {node.revocations.fresh_until for node in nodes} == {0}


@pytest.mark.attack("revoked-intermediate")
async def test_a_connection_of_two_sidecars_below_it_is_closed(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.publish("/talker", "/word")
    site.subscribe("/listener", "/word")
    intermediate = below(site, "/talker", "/listener")
    async with (
        site.running(),
        sidecar(site) as near,
        sidecar(site) as far,
        Program("/talker", near) as talker,
        Program("/listener", far) as listener,
    ):
        stream, source = await connect(SidecarPair(site, near, far, talker, listener))
        await send_list(site, site.revoke(intermediate))
        await wait_closed(stream)
        await wait_closed(source)


TALKER: Final = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
rospy.init_node("talker")
words = rospy.Publisher("/words", String, queue_size=10)
rate = rospy.Rate(20)
while not rospy.is_shutdown():
    words.publish("word")
    rate.sleep()
"""
)
HEARER: Final = (
    SECURE
    + """
import rospy
from std_msgs.msg import String
rospy.init_node("hearer")
rospy.Subscriber("/words", String, lambda message: print("HEARD", message.data, flush=True))
rospy.spin()
"""
)


@pytest.mark.ros
@pytest.mark.attack("revoked-intermediate")
async def test_a_connection_of_two_rospy_programs_below_it_is_closed(site: Site, tmp_path: Path) -> None:
    site.publish("/talker", "/words")
    site.subscribe("/hearer", "/words")
    intermediate = below(site, "/talker", "/hearer")
    env = environment(site, tmp_path / "logs")
    async with program(env, HEARER) as hearer, program(env, TALKER) as talker:
        await hearer.read_until("HEARD")
        await send_list(site, site.revoke(intermediate))
        for one in (talker, hearer):
            await one.read_until("the revocation list without a timestamp", WITHIN)
        hearer.said = ""
        with pytest.raises(TimeoutError):
            await hearer.read_until("HEARD", within=3)


@pytest.mark.attack("revoked-intermediate")
async def test_a_revoked_identity_gets_the_list_and_nothing_else(site: Site) -> None:
    assert site.master is not None
    intermediate, stolen, uri = below(site, EVE), credentials(site), site.master.uri
    data = site.revoke(intermediate)
    await send_list(site, data)
    for method, params in (("revocations", ()), ("revocationsSince", (b"",))):
        answer = await call(uri, stolen, f"rossec.{method}", EVE, *params)
        assert answer == [1, "revocations", [data, b""]]
    for method in ("rossec.trl", "system.multicall", "getUri"):
        with pytest.raises(ChannelError):
            await call(uri, stolen, method, EVE)
    held = [await dial(uri, stolen) for _ in range(MAX_CONNECTIONS)]
    with pytest.raises(ChannelError):
        await call(uri, stolen, "rossec.revocations", EVE)
    for stream in held:
        with pytest.raises(ChannelError):  # nor does it keep a connection for long
            await stream.receive()


@pytest.mark.attack("revoked-intermediate")
async def test_a_revoked_intermediate_cannot_exhaust_the_master_with_names(site: Site) -> None:
    """Each has a limit of its own; without one for the intermediate they use every descriptor."""
    assert site.master is not None
    names = [f"/eve_{number}" for number in range(MAX_BELOW_INTERMEDIATE + 8)]
    await send_list(site, site.revoke(below(site, *names)))
    held = [await dial(site.master.uri, credentials(site, name)) for name in names]
    for stream in held[MAX_BELOW_INTERMEDIATE:]:
        with pytest.raises(ChannelError):
            await stream.receive()
    assert int(site.master.status()["connections"]) <= MAX_BELOW_INTERMEDIATE
    for stream in held:
        stream.abort("seen enough")


@pytest.mark.attack("revoked-intermediate")
async def test_a_revoked_identity_gets_the_list_at_a_limited_rate(site: Site) -> None:
    assert site.master is not None
    await send_list(site, site.revoke(site.identity(EVE).thumbprint))
    stream = await dial(site.master.uri, credentials(site))
    client = RpcClient(stream)
    for _ in range(MAX_CALLS):
        await client.call("rossec.revocations", EVE)
    with pytest.raises((ChannelError, CallFailed)):
        await client.call("rossec.revocations", EVE)
