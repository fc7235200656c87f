"""A foreigner with a name of ours, names below /remote, and addresses that are none of its own."""

from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from grants.model import Right
from rossec.master.rights.access_rules import RULES, Scope
from rossec.net.rpc.calls import RpcClient
from tests.rossec.master.visiting import HOSPITAL, VisitWorld
from tests.rossec.master.world import EVERYTHING, T
from tests.support.authority import EnrolledNode

ALIAS = "/remote/hospital/rounds/robot3"
OURS: dict[str, tuple[object, ...]] = {
    "rossec.renewGrants": ([],),
    "rossec.renewIdentity": (b"",),
    "rossec.updateDelegation": (b"",),
    "rossec.updateRevocations": (b"",),
    "rossec.updateRevocationTree": (b"", b""),
    "rossec.domains": (b"",),
    "rossec.updateDomains": (b"",),
    "rossec.foreignRevocations": (HOSPITAL, b""),
    "rossec.foreignRevocationProofs": (HOSPITAL, []),
    "rossec.depositGrants": ([],),
    "rossec.deliveryStates": ([],),
    "rossec.revocationStatus": (),
    "rossec.recentDenials": (),
    "rossec.watchRenewals": (0,),
    "rossec.settleRenewals": ([],),
}
"""What only nodes of the own domain, or its authority's, may call."""


@pytest.fixture
async def world() -> AsyncIterator[VisitWorld]:
    async with AsyncExitStack() as stack:
        world = VisitWorld(stack)
        await world.start()
        yield world


async def ask(client: RpcClient, member: EnrolledNode, method: str, *params: object) -> object:
    return await client.call(method, member.name, *params)


@pytest.mark.attack("foreign-names")
def test_the_table_of_what_is_ours_is_complete() -> None:
    scopes = (Scope.AUTHORITY, Scope.MEMBER)
    assert OURS.keys() == {name for name, rule in RULES.items() if rule.scope in scopes}


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
    assert await ask(visitor.client, member, "getSystemState") == [1, "current system state", [[], [], []]]
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


@pytest.mark.attack("foreign-names")
async def test_a_foreigner_does_not_offer_an_own_nodes_service(world: VisitWorld) -> None:
    """Who looks its service up would be sent to ours."""
    own, visitor = await world.node("/robot"), await world.visitor(EVERYTHING)
    await own.ask("registerService", "/arm", "rosrpc://10.0.0.2:9", own.uri)
    params = "/s", "rosrpc://10.0.0.2:9", visitor.uri
    answer = await ask(visitor.client, world.robot, "registerService", *params)
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "registered by another node" in answer[1]
    assert world.server.state.registry.service_uri("/s") is None
