"""Calls of an enrolled node at the master without the right (M1-M8), and known faults of others.

Meanwhile an honest pair must not be disturbed; what is refused is in the audit.
"""

import asyncio
import contextlib
import itertools
import socket
import time
from pathlib import Path
from typing import Any

import pytest

from grants.model import Right
from rossec.errors import PeerRefused
from rossec.master.server.updates import MAX_CLOSING
from tests.support.attacker import EVE, call, credentials
from tests.support.caller import caller, refusal
from tests.support.site import Site
from tests.support.witness import POSE, TOPIC, Witness, until

T = "std_msgs/String"
PARAMS = Right.PARAM_GET | Right.PARAM_SET
QUERIES: list[tuple[str, tuple[object, ...]]] = [
    ("getSystemState", ()),
    ("getTopicTypes", ()),
    ("getPublishedTopics", ("",)),
    ("getParamNames", ()),
    ("lookupNode", ("/robot",)),
    ("lookupService", ("/robot/reset",)),
    ("getUri", ()),
    ("getPid", ()),
]


def uri(site: Site) -> str:
    assert site.master is not None
    return site.master.uri


def plain(port: int, data: bytes) -> bytes:
    """What the port answers to plain XML-RPC."""
    with socket.create_connection(("127.0.0.1", port), 10) as sock:
        sock.sendall(data)
        return b"".join(iter(lambda: sock.recv(65536), b""))


@pytest.mark.attack("master-recon")
async def test_m1_a_caller_that_is_not_enrolled_learns_nothing(site: Site, witness: Witness) -> None:
    assert site.master is not None
    intruder = credentials(Site(site.root.parent / "other", site.anchor.domain), "/viewer")
    answers = set()
    for method, params in QUERIES:
        with pytest.raises(PeerRefused):
            await call(uri(site), intruder, method, "/viewer", *params)
        body = f"<methodCall><methodName>{method}</methodName></methodCall>".encode()
        head = b"POST / HTTP/1.1\r\nHost: x\r\nContent-Length: %d\r\n\r\n" % len(body)
        answers.add(await asyncio.to_thread(plain, site.master.port, head + body))
    [answer] = answers  # whatever was asked
    assert b"accepts only connections secured by rossec" in answer
    assert b"robot" not in answer


@pytest.mark.attack("master-recon")
async def test_m1_a_node_sees_only_what_it_is_granted(site: Site, witness: Witness) -> None:
    async with (
        caller(site, "/robot2", {"/secret/**": PARAMS, "/secret": Right.PROVIDE}) as owner,
        caller(site, EVE) as eve,
        caller(site, "/friend", {TOPIC: Right.SUBSCRIBE, "/secret/a": Right.PARAM_GET}) as friend,
    ):
        await owner("setParam", "/secret/a", 1)
        await owner("setParam", "/secret/b", 1)
        await owner("registerService", "/secret", "rosrpc://127.0.0.1:9", owner.uri)
        assert [(await eve(method, *params))[2] for method, params in QUERIES[:4]] == [
            [[], [], []],
            [],
            [],
            [],
        ]
        assert await eve("lookupNode", "/robot") == [-1, "unknown node [/robot]", ""]
        assert await eve("lookupNode", "/nobody") == [-1, "unknown node [/nobody]", ""]
        there = await eve.refused("lookupService", "/secret")
        assert there.replace("/secret", "/none") == await eve.refused("lookupService", "/none")
        state = await friend("getSystemState")
        assert state[2] == [[[TOPIC, ["/robot"]]], [[TOPIC, ["/viewer"]]], []]
        assert (await friend("getTopicTypes"))[2] == [[TOPIC, POSE]]
        assert (await friend("getParamNames"))[2] == ["/secret/a"]
        assert (await friend("lookupNode", "/robot"))[2] == witness.robot.uri


@pytest.mark.attack("another-name")
@pytest.mark.parametrize(
    ("method", "kind"),
    [("registerPublisher", T), ("registerSubscriber", T), ("registerService", "rosrpc://h:9")],
)
async def test_m2_m3_another_name_is_refused_and_its_owner_stays_registered(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture, method: str, kind: str
) -> None:
    everything = Right.PUBLISH | Right.SUBSCRIBE | Right.PROVIDE
    async with caller(site, EVE, {"/**": everything}) as eve:
        answer = await eve.lie(method, "/robot", TOPIC, kind, eve.uri)
        assert "belongs to /eve" in refusal(answer)
        for trick in ("/robot/", "//robot", "robot", ""):
            refusal(await eve.lie(method, trick, TOPIC, kind, eve.uri))
    assert f"/eve may not {method}" in caplog.text
    assert not witness.robot._ended.done()
    assert [node.name for node in site.master.state.registry.nodes()] == ["/robot", "/viewer"]  # type: ignore[union-attr]


@pytest.mark.attack("another-name")
async def test_m4_no_node_unregisters_another(site: Site, witness: Witness) -> None:
    async with (
        caller(site, "/server", {"/add": Right.PROVIDE}) as server,
        caller(site, EVE, {"/**": Right(255) & ~Right.ADMIN}) as eve,
    ):
        where = "rosrpc://127.0.0.1:9"
        await server("registerService", "/add", where, server.uri)
        assert (await eve("lookupService", "/add"))[2] == where  # it may call it
        for name in ("/server", "/robot", "/viewer"):
            for method, *params in (
                ("unregisterService", "/add", where),
                ("unregisterPublisher", TOPIC, witness.robot.uri),
                ("unregisterSubscriber", TOPIC, witness.viewer.uri),
                ("unsubscribeParam", server.uri, "/k"),
            ):
                refusal(await eve.lie(method, name, *params))
        assert (await eve("unregisterService", "/add", where))[2] == 0  # in its own name
        assert (await eve("unregisterPublisher", TOPIC, witness.robot.uri))[2] == 0
        assert (await eve("lookupService", "/add"))[2] == where


@pytest.mark.attack("killed-master")
async def test_m5_the_master_cannot_be_shut_down(site: Site, witness: Witness) -> None:
    assert site.master is not None
    everywhere = Right(255) & ~Right.ADMIN
    async with caller(site, EVE, {"/**": everywhere, "/eve": Right.ADMIN}) as eve:
        assert "admin" in await eve.refused("shutdown", "now")
        refusal(await eve.lie("shutdown", "/master", "now"))
        refusal(await eve.lie("shutdown", "/robot", "now"))
        assert (await eve("getPid"))[0] == 1
    assert not site.master.effects.stopping.is_set()


SAFETY = "/ns/safety/max_speed"


@pytest.mark.attack("confused-rights")
async def test_m6_a_right_to_parameters_does_not_cover_their_parents(site: Site, witness: Witness) -> None:
    async with (
        caller(site, "/owner", {"/ns/**": PARAMS}) as owner,
        caller(site, EVE, {"/ns/eve/**": PARAMS}) as eve,
    ):
        await owner("setParam", SAFETY, 1)
        await owner("setParam", "/ns/eve/own", 1)
        for method, *params in (
            ("setParam", "/", {"ns": {"safety": {"max_speed": 9}}}),
            ("setParam", "/ns", {"eve": {"own": 9}}),  # would drop all else
            ("setParam", "/ns", 1),
            ("setParam", "/ns/safety", {"max_speed": 9}),
            ("setParam", SAFETY, 9),
            ("setParam", SAFETY + "/below", 9),
            ("setParam", "ns/eve/../safety", 9),
            ("setParam", "/ns//safety///max_speed", 9),
            ("setParam", "ns/safety/max_speed", 9),  # relative: /eve lives in /
            ("setParam", "/ns/eve/../safety/max_speed", 9),
            ("deleteParam", "/ns"),
            ("deleteParam", "/"),
            ("deleteParam", SAFETY),
            ("getParam", "/"),
            ("getParam", "/ns"),
            ("getParam", "/ns/safety"),
            ("getParam", SAFETY),
            ("hasParam", SAFETY),
            ("subscribeParam", eve.uri, "/ns"),
            ("subscribeParam", eve.uri, "/"),
        ):
            answer = await eve(method, *params)
            assert answer[0] == -1, (method, params, answer)
            assert answer[2] in (0, False)
        assert (await eve("searchParam", "ns"))[2] in ("", "/ns")
        assert (await eve("searchParam", SAFETY))[2] == ""
        assert (await owner("getParam", "/ns"))[2] == {"safety": {"max_speed": 1}, "eve": {"own": 1}}
        await eve("subscribeParam", eve.uri, "/ns/eve")
        await owner("setParam", SAFETY, 2)
        await owner("setParam", "/ns/eve/own", 2)
        await until(lambda: ("paramUpdate", "/ns/eve/own/", 2) in eve.told)
        assert [told for told in eve.told if told[0] == "paramUpdate"] == [("paramUpdate", "/ns/eve/own/", 2)]


@pytest.mark.attack("ros-time")
async def test_m7_ros_time_does_not_extend_a_right(tmp_path: Path) -> None:
    """/use_sim_time and /clock are set to before the end; the host's clock goes on."""
    ahead = 0.0
    site = Site(tmp_path / "site", clock=lambda: time.time() + ahead)
    async with site.running():
        assert site.master is not None
        site.master.state.clock = site._clock
        site.grant(EVE, PARAMS, "/eve/p", lifetime=60)
        site.grant(EVE, Right.PUBLISH, "/clock", lifetime=60)
        async with caller(site, EVE, {"/use_sim_time": PARAMS}) as eve:
            assert (await eve("setParam", "/use_sim_time", True))[0] == 1
            assert (await eve("registerPublisher", "/clock", "rosgraph_msgs/Clock", eve.uri))[0] == 1
            assert (await eve("setParam", "/eve/p", 1))[0] == 1
            ahead = 61.0
            assert "param-set" in await eve.refused("setParam", "/eve/p", 2)
            await eve.refused("getParam", "/eve/p")
            await eve.refused("registerPublisher", "/clock", "rosgraph_msgs/Clock", eve.uri)
            site.master.effects.list_changed.set()
            registry = site.master.state.registry
            await until(lambda: not list(registry.nodes()))
            assert (await eve("getParam", "/use_sim_time"))[2] is True


@pytest.mark.attack("master-as-tool")
async def test_m8_the_master_sends_third_parties_one_constant_line(
    site: Site, witness: Witness, caplog: pytest.LogCaptureFixture
) -> None:
    """It sends one constant line to the address, and nothing that Eve could choose."""
    loop = asyncio.get_running_loop()
    async with caller(site, EVE, {"/**": Right(255)}) as eve:
        answer = await eve("registerSubscriber", "/t", T, witness.robot.uri)
        assert "registered by another node" in refusal(answer)
        assert "another node" in await eve.refused("subscribeParam", witness.viewer.uri, "/k")
        with socket.create_server(("127.0.0.1", 0)) as internal:
            internal.setblocking(False)
            where = f"http://127.0.0.1:{internal.getsockname()[1]}/delete?all=1"
            await eve("registerSubscriber", "/t", T, where)
            await eve("registerPublisher", "/t", T, where)
            connection, _ = await loop.sock_accept(internal)
            with connection:
                heard = await loop.sock_recv(connection, 4096)
        assert heard.startswith(b"GET /rossec HTTP/1.1\r\nHost: rossec\r\nConnection: Upgrade\r\n")
        for told in (b"/t", b"delete", b"publisherUpdate", EVE.encode()):
            assert told not in heard
        for bad in ("http://h:1@evil:2/", "http://h:99999/", f"http://{'h' * 600}:1/", "http:///"):
            assert (await eve("registerSubscriber", "/t", T, bad))[0] == -1


@pytest.mark.attack("master-as-tool")
async def test_m8_calls_of_the_master_are_limited(site: Site, witness: Witness) -> None:
    """A peer that registers another address at every call would have the master call them all."""
    assert site.master is not None
    accepted: set[tuple[str, int]] = set()
    with socket.create_server(("", 0), backlog=512) as silent:
        silent.setblocking(False)
        port = silent.getsockname()[1]
        async with caller(site, EVE, {"/t": Right.SUBSCRIBE}) as eve:
            for number in range(300):
                where = f"http://127.{2 + number // 200}.1.{number % 200}:{port}/"
                assert (await eve("registerSubscriber", "/t", T, where))[0] == 1
            clients = site.master.effects.updates.nodes
            assert 0 < len(clients) <= site.limits.nodes_per_identity + MAX_CLOSING
            await asyncio.sleep(0)
            with contextlib.suppress(BlockingIOError):
                while True:
                    connection, _ = silent.accept()
                    accepted.add(connection.getsockname())
                    connection.close()
        assert len(accepted) <= len(clients)
    for bad in ("0.0.0.0", "127.1", "0x7f000001", "[::]", "255.255.255.255", "239.1.1.1"):
        async with caller(site, EVE) as eve:
            answer = await eve("registerSubscriber", "/t", T, f"http://{bad}:{port}/")
            assert answer[1] == "ERROR: parameter [caller_api] is not an RPC URI"


# --- faults found in others (F2-F5)


@pytest.mark.attack("confused-rights")
async def test_f2_two_identities_on_one_host_have_different_rights(site: Site) -> None:
    async with caller(site, "/one", {"/t": Right.PUBLISH}) as one, caller(site, "/two") as two:
        assert (await one("registerPublisher", "/t", T, one.uri))[0] == 1
        await two.refused("registerPublisher", "/t", T, two.uri)


@pytest.mark.attack("confused-rights")
async def test_f3_the_order_of_grants_does_not_matter(site: Site) -> None:
    patterns = ("/a/**", "/a/b", "/c/*")
    tokens = [site.grant("/g", Right.PARAM_SET, pattern) for pattern in patterns]
    seen: list[list[int]] = []
    for number, order in enumerate(itertools.permutations(tokens)):
        name = "/g"
        async with caller(site, name) as eve:
            await eve("rossec.presentGrants", list(order))
            keys = ("/a", "/a/b", "/a/b/c", "/ab", "/c", "/c/d", "/c/d/e")
            seen.append([(await eve("setParam", key, number))[0] for key in keys])
    assert seen == [[-1, 1, 1, -1, -1, 1, 1]] * 6


@pytest.mark.attack("confused-rights")
async def test_f4_each_method_asks_for_its_own_right(site: Site) -> None:
    needs: dict[Right, list[tuple[Any, ...]]] = {
        Right.PUBLISH: [("registerPublisher", "/x", T, "URI")],
        Right.SUBSCRIBE: [("registerSubscriber", "/x", T, "URI")],
        Right.PROVIDE: [("registerService", "/x", "rosrpc://h:9", "URI")],
        Right.CALL: [("lookupService", "/x")],
        Right.PARAM_SET: [("setParam", "/x", 1), ("deleteParam", "/x")],
        Right.PARAM_GET: [("getParam", "/x"), ("hasParam", "/x"), ("subscribeParam", "URI", "/x")],
    }
    for right, own in needs.items():
        async with caller(site, f"/only{int(right)}", {"/x": right}) as node:
            for method, *params in itertools.chain.from_iterable(needs.values()):
                filled = [node.uri if value == "URI" else value for value in params]
                code, status, _ = await node(method, *filled)
                allowed = (method, *params) in own
                assert status.startswith("rossec: ") != allowed, (right, method, code, status)


@pytest.mark.attack("confused-rights")
async def test_f5_a_name_does_not_cover_longer_names(site: Site) -> None:
    async with caller(site, EVE, {"/chatter": Right.PUBLISH, "/p": PARAMS}) as eve:
        assert (await eve("registerPublisher", "/chatter", T, eve.uri))[0] == 1
        for name in ("/chatterX", "/chatter/x", "/chatte", "/"):
            assert (await eve("registerPublisher", name, T, eve.uri))[0] == -1
        assert (await eve("setParam", "/p/below", 1))[0] == 1
        await eve.refused("setParam", "/px", 1)
