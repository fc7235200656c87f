"""Nodes of other domains at the master: who is let in, as whom, and what each may not do."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace

import pytest

from ca.authority import create_root
from ca.errors import DomainsRefused
from ca.keys.publickey import thumbprint
from grants.model import Right
from rossec.channel.edhoc.known import KnownCertificates
from rossec.errors import RossecError
from rossec.master.rights.access_rules import RULES, Scope
from rossec.master.rights.domain_trust import GRACE
from rossec.net.aio import WireProtocol, connect
from rossec.net.rpc.client import RpcClient
from rossec.ros.settings import parse_uri
from rossec.ros.xmlrpc import Fault
from tests.rossec.master.visiting import HOSPITAL, Hospital, VisitWorld
from tests.rossec.master.world import EVERYTHING, T, ends, until
from tests.support.authority import EnrolledNode
from tests.support.contexts import unlimited

ALIAS = "/remote/hospital/rounds/robot3"
OURS: dict[str, tuple[object, ...]] = {
    "rossec.renewGrants": ([],), "rossec.renewIdentity": (b"",),
    "rossec.updateDelegation": (b"",), "rossec.updateRevocations": (b"",),
    "rossec.updateRevocationTree": (b"", b""), "rossec.domains": (b"",),
    "rossec.updateDomains": (b"",), "rossec.foreignRevocations": (HOSPITAL, b""),
    "rossec.foreignRevocationProofs": (HOSPITAL, []), "rossec.depositGrants": ([],),
    "rossec.deliveryStates": ([],), "rossec.revocationStanding": (), "rossec.recentDenials": (),
}  # fmt: skip
"""What only nodes of the own domain, or its authority's, may call."""


@pytest.mark.attack("foreign-names")
def test_the_table_of_what_is_ours_is_complete() -> None:
    scopes = (Scope.AUTHORITY, Scope.MEMBER)
    assert OURS.keys() == {name for name, rule in RULES.items() if rule.scope in scopes}


@pytest.fixture
async def world() -> AsyncIterator[VisitWorld]:
    async with AsyncExitStack() as stack:
        world = VisitWorld(stack)
        await world.start()
        yield world


async def refused(world: VisitWorld, member: EnrolledNode) -> None:
    """It gets nothing: not even an answer."""
    await ends(world.connect(member))


async def ask(client: RpcClient, member: EnrolledNode, method: str, *params: object) -> object:
    return await client.call(method, member.name, *params)


@pytest.mark.attack("foreign-node")
async def test_a_leaf_of_a_domain_that_is_not_listed(world: VisitWorld) -> None:
    await refused(world, Hospital("clinic.example").site.enroll("/rounds/robot3"))


@pytest.mark.attack("foreign-node")
async def test_a_leaf_of_a_domain_whose_time_is_over(world: VisitWorld) -> None:
    entry = world.hospital.entry(until=world.site.now - 1)
    world.trust.update_domains(world.lists.next(entry))
    await refused(world, world.robot)


@pytest.mark.attack("foreign-node")
async def test_a_leaf_of_a_removed_domain(world: VisitWorld) -> None:
    client = await world.connect(world.robot)
    own = await world.node("/robot")
    assert await own.ask("rossec.updateDomains", world.lists.next()) == 1
    await ends(client.ask("getPid", world.robot.name))
    await refused(world, world.robot)


@pytest.mark.attack("foreign-node")
async def test_a_leaf_with_the_name_of_another_domain(world: VisitWorld) -> None:
    clinic = Hospital(HOSPITAL)  # another root, the same domain in its certificates
    await refused(world, clinic.site.enroll("/rounds/robot3"))


@pytest.mark.attack("foreign-node")
async def test_a_leaf_that_claims_the_own_domain(world: VisitWorld) -> None:
    await refused(world, Hospital("home").site.enroll("/robot"))


@pytest.mark.attack("foreign-node")
async def test_a_name_that_is_not_admitted(world: VisitWorld) -> None:
    entry = world.hospital.entry(admitted=("/rounds/*",))
    world.trust.update_domains(world.lists.next(entry))
    world.trust.domains.take(HOSPITAL, *world.hospital.word(), world.site.now)
    await world.connect(world.robot)
    await refused(world, world.hospital.site.enroll("/kitchen/robot3"))


@pytest.mark.attack("foreign-node")
async def test_a_leaf_while_nothing_is_known_of_its_domains_revocations(world: VisitWorld) -> None:
    other = Hospital("clinic.example")
    world.trust.update_domains(world.lists.next(world.hospital.entry(), other.entry("clinic")))
    visitor = other.site.enroll("/rounds/robot3")
    await refused(world, visitor)
    world.trust.domains.take("clinic.example", *other.word(), world.site.now)
    await world.connect(visitor)


@pytest.mark.attack("foreign-node")
async def test_revoked_by_its_own_authority_it_gets_nothing(world: VisitWorld) -> None:
    visitor = await world.visitor(EVERYTHING)
    await visitor.ask("registerPublisher", "/pose", T, visitor.uri)
    world.take(world.robot)
    assert list(world.server.state.registry.nodes()) == []
    await ends(visitor.ask("rossec.revocations"))
    await refused(world, world.robot)


@pytest.mark.attack("foreign-node")
async def test_revoked_by_this_authority_it_gets_nothing(world: VisitWorld) -> None:
    visitor = await world.visitor(EVERYTHING)
    await visitor.ask("registerPublisher", "/pose", T, visitor.uri)
    own = await world.node("/robot")
    await own.ask("rossec.updateRevocations", world.site.revoke(world.robot))
    assert [node.name for node in world.server.state.registry.nodes()] == []
    await ends(visitor.ask("rossec.revocations"))
    await refused(world, world.robot)


@pytest.mark.attack("foreign-node")
async def test_an_older_list_of_its_domain_revives_nobody(world: VisitWorld) -> None:
    old = world.hospital.word()
    world.take(world.robot)
    with pytest.raises(Exception, match="older"):
        world.server._effects.take_foreign(HOSPITAL, *old)
    await refused(world, world.robot)


@pytest.mark.attack("foreign-node")
async def test_stale_revocations_end_a_visit_after_a_minute(world: VisitWorld) -> None:
    now, client = world.site.now, await world.connect(world.robot)
    identity = world.trust.domains.anchors.verify(world.robot.credentials.chain, now)
    world.trust.caller(identity, now + 3600)
    world.trust.caller(identity, now + 3700)  # stale since 100 s, noticed now
    world.server.state.clock = lambda: now + 3700 + GRACE
    world.server._effects.close_revoked()
    await ends(client.ask("getPid", world.robot.name))


@pytest.mark.attack("foreign-node")
async def test_two_domains_with_one_root(world: VisitWorld) -> None:
    signer, now = world.hospital.site.signer, world.site.now
    root = create_root(signer, "clinic.example", now=now, serial=7)
    clinic = replace(world.hospital.entry("clinic"), domain="clinic.example", root=root)
    with pytest.raises(DomainsRefused, match="share a label or a root key"):
        world.lists.next(world.hospital.entry(), clinic)


@pytest.mark.attack("foreign-names")
@pytest.mark.parametrize("name", ["/ca", "/master", "/robot"])
async def test_a_foreigner_with_the_name_of_one_of_ours(world: VisitWorld, name: str) -> None:
    """It is another node: neither the authority, nor the master, nor the robot."""
    own = await world.node("/robot")
    await own.ask("registerPublisher", "/pose", T, own.uri)
    member = world.hospital.site.enroll(name)
    visitor = await world.visitor({"/visit": Right.PUBLISH}, member)
    for method in sorted(OURS):
        answer = await ask(visitor.client, member, method, *OURS[method])
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "only" in answer[1]
        assert "own" in answer[1]
    assert await ask(visitor.client, member, "getSystemState") == [
        1, "current system state", [[], [], []]
    ]  # fmt: skip
    await visitor.ask("registerPublisher", "/visit", T, visitor.uri)
    await visitor.ask("unregisterPublisher", "/pose", own.uri)
    registry = world.server.state.registry
    assert {node.name for node in registry.nodes()} == {"/robot", f"/remote/hospital{name}"}
    assert [node.name for node in registry.nodes() if node.uri == own.uri] == ["/robot"]


@pytest.mark.attack("foreign-names")
async def test_a_foreigner_calls_itself_by_its_name_at_home_and_no_other(world: VisitWorld) -> None:
    visitor = await world.visitor(EVERYTHING)
    for other in (ALIAS, "/robot", "/rounds/robot4", "/remote/hospital/rounds/robot4"):
        answer = await visitor.client.call("registerPublisher", other, "/pose", T, visitor.uri)
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert "belongs to hospital:/rounds/robot3" in answer[1]
    await visitor.ask("registerPublisher", "/pose", T, visitor.uri)
    assert [node.name for node in world.server.state.registry.nodes()] == [ALIAS]


@pytest.mark.attack("foreign-names")
@pytest.mark.parametrize(
    ("method", "params"),
    [
        ("registerPublisher", ("/remote/hospital/pose", T, "http://10.0.0.9:1/")),
        ("registerService", ("/remote/hospital/s", "rosrpc://10.0.0.9:2", "http://10.0.0.9:1/")),
        ("setParam", ("/remote/hospital/rate", 1)),
        ("setParam", ("/remote", {"hospital": {"rate": 1}})),
        ("deleteParam", ("/remote/hospital/rate",)),
    ],
)
async def test_an_own_node_offers_nothing_below_remote(
    world: VisitWorld, method: str, params: tuple[object, ...]
) -> None:
    own = await world.node("/robot")  # with a grant of everything
    answer = await own.client.call(method, "/robot", *params)
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "rossec: " in answer[1]
    assert list(world.server.state.registry.nodes()) == []


@pytest.mark.attack("foreign-grants")
async def test_a_hospital_grants_nothing_of_the_home(world: VisitWorld) -> None:
    visitor = await world.visitor({"/visit": Right.PUBLISH})
    grant = world.hospital.site.grant(world.robot, EVERYTHING)
    answer = await ask(visitor.client, world.robot, "rossec.presentGrants", [grant])
    assert isinstance(answer, list)
    assert "refused: " in answer[1]
    with pytest.raises(RossecError):
        await visitor.ask("registerPublisher", "/pose", T, visitor.uri)


@pytest.mark.attack("foreign-grants")
async def test_a_grant_of_the_hospital_for_an_own_node_counts_there_alone(
    world: VisitWorld,
) -> None:
    own = await world.node("/robot", {"/own": Right.SUBSCRIBE})
    grant = world.hospital.site.grant(own.member, {"/pose": Right(255)})
    assert await own.ask("rossec.presentGrants", [grant]) == 2
    await own.ask("registerSubscriber", "/remote/hospital/pose", T, own.uri)
    for topic in ("/pose", "/remote/clinic/pose", "/remote/hospital/other"):
        with pytest.raises(RossecError):
            await own.ask("registerSubscriber", topic, T, own.uri)


@pytest.mark.attack("foreign-grants")
async def test_a_grant_of_a_domain_ends_with_the_trust_in_it(world: VisitWorld) -> None:
    own = await world.node("/robot", {"/own": Right.SUBSCRIBE})
    grant = world.hospital.site.grant(own.member, {"/pose": Right.SUBSCRIBE})
    await own.ask("rossec.presentGrants", [grant])
    await own.ask("registerSubscriber", "/remote/hospital/pose", T, own.uri)
    await own.ask("rossec.updateDomains", world.lists.next())
    assert list(world.server.state.registry.nodes()) == []


@pytest.mark.attack("foreign-grants")
async def test_a_grant_the_hospital_revoked_ends_at_once(world: VisitWorld) -> None:
    own = await world.node("/robot", {"/own": Right.SUBSCRIBE})
    grant = world.hospital.site.grant(own.member, {"/pose": Right.SUBSCRIBE})
    await own.ask("rossec.presentGrants", [grant])
    await own.ask("registerSubscriber", "/remote/hospital/pose", T, own.uri)
    world.take(grant)
    assert list(world.server.state.registry.nodes()) == []


@pytest.mark.attack("foreign-grants")
async def test_the_hospital_revokes_nothing_of_the_home(world: VisitWorld) -> None:
    own = await world.node("/robot")
    await own.ask("registerPublisher", "/pose", T, own.uri)
    world.take(own.grant, own.member)
    await own.ask("registerPublisher", "/other", T, own.uri)
    assert [node.name for node in world.server.state.registry.nodes()] == ["/robot"]


@pytest.mark.attack("foreign-node")
async def test_one_key_in_two_domains_is_two_nodes(world: VisitWorld) -> None:
    """A home identity shown as a foreign one has none of its rights."""
    own = await world.node("/robot", {"/own": Right.SUBSCRIBE})
    twin = world.hospital.site.certify("/rounds/robot3", own.member.signer)
    client = await world.call_as(twin)
    assert thumbprint(own.member.signer.public_key) == twin.thumbprint
    answer = await ask(client, twin, "registerSubscriber", "/own", T, own.uri)
    assert isinstance(answer, list)
    assert answer[0] == -1


@pytest.mark.attack("foreign-flood")
async def test_a_domain_has_a_limited_number_of_connections(
    world: VisitWorld, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING, "rossec")
    world.server._limits = world.server._limits.__class__(connections_per_domain=4)
    robots = [world.hospital.site.enroll(f"/rounds/robot{number}") for number in range(6)]
    found = await asyncio.gather(
        *(world.connect(robot) for robot in robots), return_exceptions=True
    )
    assert sum(isinstance(each, RpcClient) for each in found) == 4
    assert "hospital:/rounds/robot" in caplog.text
    await world.node("/robot")  # others have room


@pytest.mark.attack("foreign-node")
async def test_what_ends_with_its_time_ends_on_time(world: VisitWorld) -> None:
    client = await world.connect(world.robot)
    own = await world.node("/robot")
    entry = world.hospital.entry(until=world.site.now + 3)
    await own.ask("rossec.updateDomains", world.lists.next(entry))
    await until(lambda: not any(each.peer.is_foreign for each in world.server.state.streams))
    await ends(client.ask("getPid", world.robot.name))


@pytest.mark.attack("foreign-names")
@pytest.mark.parametrize("host", ["169.254.1.1", "[fe80::1]", "0.0.0.0", "224.0.0.1"])
async def test_a_foreigner_has_no_address_that_means_another_machine_here(
    world: VisitWorld, host: str
) -> None:
    visitor = await world.visitor(EVERYTHING)
    for method, params in (
        ("registerPublisher", ("/pose", T, f"http://{host}:7/")),
        ("subscribeParam", (f"http://{host}:7/", "/rate")),
        ("registerService", ("/s", f"rosrpc://{host}:7", visitor.uri)),
    ):
        answer = await ask(visitor.client, world.robot, method, *params)
        assert isinstance(answer, list)
        assert answer[0] == -1
    assert list(world.server.state.registry.nodes()) == []


@pytest.mark.attack("foreign-names")
async def test_a_foreigner_does_not_take_an_own_nodes_address(world: VisitWorld) -> None:
    own, visitor = await world.node("/robot"), await world.visitor(EVERYTHING)
    await own.ask("registerPublisher", "/pose", T, own.uri)
    answer = await ask(visitor.client, world.robot, "registerPublisher", "/x", T, own.uri)
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "registered by another node" in answer[1]


@pytest.mark.attack("foreign-node")
async def test_a_revoked_foreigner_within_a_multicall(world: VisitWorld) -> None:
    visitor = await world.visitor(EVERYTHING)
    world.trust.domains.take(HOSPITAL, *world.hospital.word(world.robot), world.site.now)
    calls = [{"methodName": "getPid", "params": [world.robot.name]}]
    with pytest.raises((Fault, RossecError)):
        await visitor.client.call("system.multicall", calls)


@pytest.mark.attack("foreign-node")
async def test_a_certificate_named_by_its_hash_is_verified_again(world: VisitWorld) -> None:
    """The master remembers certificates of handshakes; what it remembers is not trusted."""
    host, port = parse_uri(world.server.uri)
    own, known = world.robot.credentials, KnownCertificates()
    context = unlimited(own, world.site.anchor.verify, known=known)
    for _ in range(2):  # the second one names the certificate it has sent before
        stream = await connect(host, port, context, WireProtocol.HTTP)
        await RpcClient(stream).ask("getPid", world.robot.name)
        await stream.close()
    assert known.is_introduced(world.master.credentials.chain[0])
    world.trust.update_domains(world.lists.next())
    with pytest.raises(RossecError):
        await RpcClient(await connect(host, port, context, WireProtocol.HTTP)).ask(
            "getPid", world.robot.name
        )
