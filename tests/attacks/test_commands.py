"""Calls an attacker with a good identity makes at the APIs of nodes and master (see attacks.md).

Only the master controls a node, no node acts under another's name, a revocation is final.
"""

from typing import Final

import pytest

from ca.errors import RevocationRefused
from grants import document
from rossec.net.rpc.calls import RpcClient
from rossec.ros.names import MASTER, REVOCATION_UPDATE
from tests.support.attacker import EVE, HOST, call, credentials, dial, flip, revoke, signed
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness


@pytest.mark.attack("existence-oracle")
async def test_the_slave_api_does_not_tell_which_topics_exist(site: Site, witness: Witness) -> None:
    eve, uri = credentials(site), witness.robot.uri
    answers = [
        await call(uri, eve, "requestTopic", EVE, topic, [["TCPROS"]])
        for topic in (TOPIC, "/nothing", "no name at all")
    ]
    assert answers[0] == answers[1] == answers[2]


SLAVE_CALLS: Final[list[tuple[str, tuple[object, ...]]]] = [
    ("shutdown", ("bye",)),
    ("publisherUpdate", (TOPIC, [])),
    ("publisherUpdate", (TOPIC, ["http://127.0.0.1:1/"])),
    ("paramUpdate", ("/use_sim_time", True)),
    ("rossec.revocationUpdate", (b"list", b"timestamp")),
    ("getBusInfo", ()),
    ("getBusStats", ()),
    ("getSubscriptions", ()),
    ("getPublications", ()),
    ("getPid", ()),
    ("getMasterUri", ()),
]


@pytest.mark.attack("steered-node")
@pytest.mark.parametrize("victim", ["/robot", "/viewer"])
async def test_only_the_master_controls_or_queries_a_node(site: Site, witness: Witness, victim: str) -> None:
    """N1 to N4, also under the master's name and with every other trick of spelling."""
    node = witness.robot if victim == "/robot" else witness.viewer
    stream = await dial(node.uri, credentials(site))
    client = RpcClient(stream)
    for method, parameters in SLAVE_CALLS:
        for caller in (EVE, MASTER, victim):
            answer = await client.call(method, caller, *parameters)
            assert isinstance(answer, list)
            assert answer[0] == -1
            assert answer[1] == f"rossec: {method} is for the master alone"
            assert answer[2] in (0, -1, "", [])
    await stream.close()


@pytest.mark.attack("udpros")
async def test_udpros_is_never_offered(site: Site, witness: Witness) -> None:
    protocols = [["UDPROS", b"", HOST, 9, 1500]]
    answer = await call(witness.robot.uri, credentials(site), "requestTopic", EVE, TOPIC, protocols)
    hint = "in C++: ros::TransportHints().reliable()"
    assert answer == [-1, f"rossec: only TCPROS, inside the secure channel; {hint}", []]


@pytest.mark.attack("old-list")
async def test_an_older_or_forged_revocation_list_is_refused_by_the_node(
    site: Site, witness: Witness
) -> None:
    """D1, from the master itself: a compromised master cannot bring a grant back."""
    old = site.authority.store.newest_list()
    assert old is not None
    grant = signed(site)
    await revoke(site, witness, grant)
    forged = flip(old, len(old) - 1)
    master, floor = credentials(site, MASTER), witness.robot.revocations.floor
    for data, said in ((old, "older"), (forged, "verify"), (b"", "COSE")):
        answer = await call(witness.robot.uri, master, "rossec.revocationUpdate", MASTER, data, b"timestamp")
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert said in answer[1]
    with pytest.raises(RevocationRefused, match="is older than"):
        witness.robot.push_arrived(REVOCATION_UPDATE, (old, b""), site.identity(MASTER))
    with pytest.raises(RevocationRefused):
        witness.robot.push_arrived(REVOCATION_UPDATE, (forged, b""), site.identity(MASTER))
    assert witness.robot.revocations.floor == floor
    assert document.grant_id(grant) in witness.robot.revocations.entries


@pytest.mark.attack("old-list")
async def test_an_older_or_forged_revocation_list_is_refused_by_the_master(
    site: Site, witness: Witness
) -> None:
    """D1: any node may carry a list to the master, but none may bring back an older one."""
    assert site.master is not None
    old = site.authority.store.newest_list()
    assert old is not None
    await revoke(site, witness, signed(site))
    newest = site.authority.store.newest_list()
    for data, said in ((old, "older"), (flip(old, len(old) - 1), "verify"), (b"", "COSE")):
        answer = await call(site.master.uri, credentials(site), "rossec.updateRevocations", EVE, data)
        assert isinstance(answer, list)
        assert answer[0] == -1
        assert said in answer[1]
    held = await witness.robot._membership.session.call("rossec.revocations")
    assert isinstance(held, list)
    assert held[0] == newest


@pytest.mark.attack("another-name")
async def test_no_node_registers_under_the_name_of_another(site: Site, witness: Witness) -> None:
    """M2, M3: stock ROS would shut the victim down."""
    assert site.master is not None
    eve, mine = credentials(site), "http://127.0.0.1:9/"
    for method, parameters in (
        ("registerPublisher", (TOPIC, POSE, mine)),
        ("registerSubscriber", (TOPIC, POSE, mine)),
        ("registerService", ("/robot/s", mine, mine)),
        ("unregisterPublisher", (TOPIC, witness.robot.uri)),
        ("unregisterSubscriber", (TOPIC, witness.viewer.uri)),
    ):
        for victim in ("/robot", "/viewer", MASTER):
            answer = await call(site.master.uri, eve, method, victim, *parameters)
            assert isinstance(answer, list)
            assert answer[0] == -1
            assert answer[1].startswith("rossec: ")
    assert not witness.robot._ended.done()
    assert not witness.viewer._ended.done()


@pytest.mark.attack("another-name")
async def test_no_node_registers_the_address_of_another(site: Site, witness: Witness) -> None:
    """M8: the master would call, or send subscribers to, an address the caller chose."""
    assert site.master is not None
    site.publish(EVE, "/eve/**")
    eve = credentials(site)
    await call(site.master.uri, eve, "rossec.presentGrants", EVE, site.enroll(EVE).grants())
    answer = await call(site.master.uri, eve, "registerPublisher", EVE, "/eve/x", POSE, witness.robot.uri)
    assert isinstance(answer, list)
    assert answer[0] == -1
    assert "another node" in answer[1]
