"""The slave API of a secured rospy node: who may control and who may query it (N1-N5, N10)."""

import asyncio
import contextlib
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from ca.encoding import encode
from grants.model import Right
from rossec.errors import ChannelError, RossecError
from rossec.net.rpc.calls import RpcClient
from rossec.ros.names import MASTER
from rossec.ros.xmlrpc import Fault
from tests.support.attacker import EVE, HOST, call, credentials, dial
from tests.support.victim import COMMAND, PARAMETER, STATE, Victim, attacked
from tests.support.witness import until

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def victim(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Victim]:
    directory: Path = tmp_path_factory.mktemp("victim")
    async with attacked(directory) as victim:
        yield victim


async def ask(victim: Victim, method: str, *params: object) -> Any:
    """The answer to Eve, who is enrolled and has no grant."""
    answer = await call(victim.uri, credentials(victim.site), method, *params)
    await victim.goes_on(3)
    return answer


STEERING = {
    "shutdown": ("x",),
    "publisherUpdate": (COMMAND, ["http://127.0.0.1:1/"]),
    "paramUpdate": (PARAMETER, 99),
}


@pytest.mark.attack("steered-node")
@pytest.mark.parametrize("method", STEERING)
@pytest.mark.parametrize("caller", [EVE, MASTER])
async def test_only_the_master_controls_a_node(victim: Victim, method: str, caller: str) -> None:
    """N1, N2, N3: the certificate counts, not what the caller calls itself."""
    code, status, _ = await ask(victim, method, caller, *STEERING[method])
    assert code == -1
    assert status == f"rossec: {method} is for the master alone"


@pytest.mark.attack("false-publisher")
@pytest.mark.parametrize("uris", [[], ["{evil}"]])
async def test_a_false_publisher_update_is_refused(victim: Victim, uris: list[str]) -> None:
    """N2: not even a connection is made."""
    with socket.create_server((HOST, 0)) as evil:
        evil.setblocking(False)
        where = f"http://{HOST}:{evil.getsockname()[1]}/"
        named = [uri.format(evil=where) for uri in uris]
        assert (await ask(victim, "publisherUpdate", MASTER, COMMAND, named))[0] == -1
        with pytest.raises(BlockingIOError):
            evil.accept()


RECON = (
    "getBusInfo",
    "getBusStats",
    "getSubscriptions",
    "getPublications",
    "getPid",
    "getMasterUri",
    "getName",
    "getUri",
    "system.listMethods",
    "_ready",
    "reg_man",
    "rossec.revocationUpdate",
)


@pytest.mark.attack("existence-oracle")
@pytest.mark.parametrize("method", RECON)
async def test_a_peer_without_a_grant_learns_nothing_of_the_node(victim: Victim, method: str) -> None:
    """N4."""
    try:
        answer = await ask(victim, method, EVE)
    except Fault as fault:
        answer = [-1, fault.faultString, 0]
    assert answer[0] == -1
    assert answer[1].startswith("rossec: ")
    assert not answer[2] or answer[2] == -1
    assert not any(word in str(answer) for word in ("state", "command", "String", victim.uri))


@pytest.mark.attack("existence-oracle")
async def test_request_topic_does_not_tell_whether_a_topic_exists(victim: Victim) -> None:
    """N5: the grant is checked at the topic's port, before a byte is sent."""
    there = await ask(victim, "requestTopic", EVE, STATE, [["TCPROS"]])
    absent = await ask(victim, "requestTopic", EVE, "/robot/none", [["TCPROS"]])
    assert there == absent == [1, "ready", ["TCPROS", HOST, victim.port]]


async def answer_with_grant(victim: Victim, name: str, right: Right, method: str, *params: object) -> Any:
    """The answer to `name`, which has presented a grant for `right` on the robot."""
    grant = victim.site.grant(name, right, "/robot")
    client = RpcClient(await dial(victim.uri, credentials(victim.site, name)))
    try:
        assert await client.call("rossec.presentGrants", name, encode([grant])) == [1, "", 0]
        return await client.call(method, name, *params)
    finally:
        await client.close()


@pytest.mark.attack("steered-node")
async def test_an_operator_may_query_the_node(victim: Victim) -> None:
    """What `rosnode info` and `rosnode ping` need."""
    process = victim.program.process
    assert await answer_with_grant(victim, "/operator", Right.GRAPH, "getPid") == [1, "", process.pid]
    code, _, topics = await answer_with_grant(victim, "/operator", Right.GRAPH, "getPublications")
    assert code == 1
    assert [STATE, "std_msgs/String"] in topics
    stats = await answer_with_grant(victim, "/operator", Right.GRAPH, "getBusStats")
    assert stats[2] == [[], [], []], "they would count what a grant withholds"
    for method in ("getBusInfo", "getSubscriptions", "getMasterUri"):
        assert (await answer_with_grant(victim, "/operator", Right.GRAPH, method))[0] == 1
    assert (await answer_with_grant(victim, "/operator", Right.GRAPH, "getName"))[2] == "/robot"
    assert (await answer_with_grant(victim, "/operator", Right.GRAPH, "getUri"))[2] == victim.uri


@pytest.mark.attack("steered-node")
@pytest.mark.parametrize("method", STEERING)
async def test_no_grant_allows_to_control_a_node(victim: Victim, method: str) -> None:
    """Neither `graph` nor `admin`; but an administrator may shut it down."""
    rights = [Right.GRAPH] if method == "shutdown" else [Right.GRAPH, Right.ADMIN]
    for right in rights:
        name = f"/{right.label}_only"
        answer = await answer_with_grant(victim, name, right, method, *STEERING[method])
        assert answer[0] == -1
        assert answer[1].startswith("rossec: ")
    await victim.goes_on(3)


@pytest.mark.attack("steered-node")
async def test_grants_count_for_their_right_holder_and_connection(victim: Victim) -> None:
    site = victim.site
    eve = credentials(site)
    stolen = site.grant("/operator", Right.GRAPH, "/robot")
    other = site.grant(EVE, Right.GRAPH, "/other")
    wrong = site.grant(EVE, Right.SUBSCRIBE, "/robot")
    for shown in (encode([stolen]), encode([other]), encode([wrong]), encode([]), b"", b"\xff"):
        client = RpcClient(await dial(victim.uri, eve))
        await client.call("rossec.presentGrants", EVE, shown)
        answer = await client.call("getPid", EVE)
        assert isinstance(answer, list)
        assert answer[0] == -1, shown
        await client.close()
    # Grants presented on one connection do not count on another.
    await answer_with_grant(victim, "/operator", Right.GRAPH, "getPid")
    later = await call(victim.uri, credentials(site, "/operator"), "getPid", "/operator")
    assert isinstance(later, list)
    assert later[:2] == [-1, "rossec: getPid is for the master alone"]


@pytest.mark.attack("udpros")
async def test_udpros_is_not_offered(victim: Victim) -> None:
    """N10: there is no plain transport."""
    udp = ["UDPROS", "x", HOST, 5555, 1500]
    code, said, _ = await ask(victim, "requestTopic", EVE, STATE, [udp])
    hint = "in C++: ros::TransportHints().reliable()"
    assert (code, said) == (-1, f"rossec: only TCPROS, inside the secure channel; {hint}")
    assert (await ask(victim, "requestTopic", EVE, STATE, [udp, ["TCPROS"]]))[2][0] == "TCPROS"


@pytest.mark.attack("another-name")
async def test_a_call_in_the_name_of_another_is_refused(victim: Victim) -> None:
    code, status, _ = await ask(victim, "requestTopic", "/viewer", STATE, [["TCPROS"]])
    assert (code, status) == (-1, "rossec: caller_id is not /eve")


@pytest.mark.attack("node-load")
@pytest.mark.parametrize(
    ("params", "said"),
    [
        ((), "missing required caller_id parameter"),
        ((1,), "caller_id must be a string"),
        ((EVE,), "Error: bad call arity or types"),
        ((EVE, STATE), "Error: bad call arity or types"),
        ((EVE, STATE, "TCPROS", 3), "Error: bad call arity or types"),
    ],
)
async def test_malformed_calls_are_refused(victim: Victim, params: tuple[object, ...], said: str) -> None:
    assert (await ask(victim, "requestTopic", *params))[:2] == [-1, said]


@pytest.mark.attack("node-load")
async def test_connections_to_the_api_are_limited_per_identity(victim: Victim) -> None:
    """N8: beyond the limit of one identity the others are served."""
    eve = credentials(victim.site)
    streams = [await dial(victim.uri, eve) for _ in range(70)]
    try:
        await asyncio.sleep(0)
        with pytest.raises(RossecError):
            await call(victim.uri, eve, "requestTopic", EVE, STATE, [["TCPROS"]])
        other = credentials(victim.site, "/other")
        assert await call(victim.uri, other, "requestTopic", "/other", STATE, [["TCPROS"]])
        await victim.goes_on(3)
    finally:
        for stream in streams:
            stream.abort("enough")


@pytest.mark.attack("outlived-right")
async def test_a_revoked_identity_learns_nothing(victim: Victim) -> None:
    """D2: not even where a topic is, over a connection made after its revocation."""
    site = victim.site
    traitor = credentials(site, "/traitor")
    ask = "requestTopic", "/traitor", STATE, [["TCPROS"]]
    answer = await call(victim.uri, traitor, *ask)
    assert isinstance(answer, list)
    assert answer[0] == 1
    open_still = await dial(victim.uri, traitor)
    data = site.revoke(site.identity("/traitor").thumbprint)
    await victim.viewer._membership.session.call("rossec.updateRevocations", data)
    async with asyncio.timeout(20):
        await open_still.wait_ended()
    for _ in range(5):
        with contextlib.suppress(ChannelError):  # closed by the check of connections
            answer = await call(victim.uri, traitor, *ask)
            assert isinstance(answer, list)
            assert answer[0] == -1
            assert answer[1].endswith("is revoked")
    await victim.goes_on(3)


@pytest.mark.attack("steered-node")
async def test_an_administrator_ends_the_node(victim: Victim) -> None:
    """What `rosnode kill` needs; the last thing that happens here."""
    with contextlib.suppress(ChannelError):  # as stock: it may end before it has answered
        await answer_with_grant(victim, "/admin", Right.ADMIN, "shutdown", "enough")
    await until(lambda: "ENDED" in victim.said)
