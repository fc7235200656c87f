"""Nodes of other domains at the master: who is let in, as whom, and what each may not do."""

import asyncio
import logging
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack
from dataclasses import replace

import pytest

from ca.authority import create_root
from ca.errors import DomainsRefused, Revoked
from ca.keys.signing import thumbprint
from grants.model import Right
from rossec.channel.edhoc.credentials import KnownCertificates
from rossec.errors import RossecError
from rossec.master.operation.config import MasterLimits
from rossec.master.rights.domain_trust import GRACE
from rossec.net.aio import WireProtocol, connect
from rossec.net.rpc.calls import RpcClient
from rossec.ros.names import parse_uri
from rossec.ros.xmlrpc import Fault
from tests.rossec.master.visiting import HOSPITAL, Hospital, VisitWorld
from tests.rossec.master.world import EVERYTHING, T, ends, until
from tests.support.authority import EnrolledNode
from tests.support.contexts import unlimited

ALIAS = "/remote/hospital/rounds/robot3"


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
        world.server.effects.take_foreign(HOSPITAL, *old)
    await refused(world, world.robot)


@pytest.mark.attack("foreign-node")
async def test_stale_revocations_end_a_visit_after_a_minute(world: VisitWorld) -> None:
    now, client = world.site.now, await world.connect(world.robot)
    identity = world.trust.domains.anchors.verify(world.robot.credentials.chain, now)
    world.trust.caller(identity, now + 3600)
    world.trust.caller(identity, now + 3700)  # stale since 100 s, noticed now
    world.server.state.clock = lambda: now + 3700 + GRACE
    world.server.effects.close_revoked()
    await ends(client.ask("getPid", world.robot.name))


@pytest.mark.attack("foreign-node")
async def test_two_domains_with_one_root(world: VisitWorld) -> None:
    signer, now = world.hospital.site.signer, world.site.now
    root = create_root(signer, "clinic.example", now=now, serial=7)
    clinic = replace(world.hospital.entry("clinic"), domain="clinic.example", root=root)
    with pytest.raises(DomainsRefused, match="share a label or a root key"):
        world.lists.next(world.hospital.entry(), clinic)


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
async def test_a_grant_of_the_hospital_for_an_own_node_counts_there_alone(world: VisitWorld) -> None:
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
    world.server._admission._limits = MasterLimits(connections_per_domain=4)
    robots = [world.hospital.site.enroll(f"/rounds/robot{number}") for number in range(6)]
    found = await asyncio.gather(*(world.connect(robot) for robot in robots), return_exceptions=True)
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
    assert world.master.credentials.chain[0] in known.introduced
    world.trust.update_domains(world.lists.next())
    with pytest.raises(RossecError):
        await RpcClient(await connect(host, port, context, WireProtocol.HTTP)).ask("getPid", world.robot.name)


@pytest.mark.attack("foreign-node")
async def test_a_master_of_a_stale_domain_is_let_in_without_a_right(world: VisitWorld) -> None:
    """Of two masters that know nothing of each other one must speak first."""
    other = Hospital("clinic.example")
    world.trust.update_domains(world.lists.next(world.hospital.entry(), other.entry("clinic")))
    visitor = await world.visitor(EVERYTHING, other.master)
    assert await visitor.ask("getSystemState") == [[], [], []]
    with pytest.raises(RossecError):
        await visitor.ask("registerPublisher", "/t", T, visitor.uri)
    world.server.effects.take_foreign("clinic.example", *other.word())
    await visitor.ask("registerPublisher", "/t", T, visitor.uri)
    with pytest.raises(Revoked):  # it says so itself; its word does not count, the list does
        world.server.effects.take_foreign("clinic.example", *other.word(other.master))
    await ends(visitor.ask("getPid"))
    await refused(world, other.master)
