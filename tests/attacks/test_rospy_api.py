"""The node API of a secured rospy node: who may steer it, and who may ask (N1-N5, N10)."""

import asyncio
import socket
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import pytest
import pytest_asyncio

from rossec.errors import RossecError
from rossec.node.slave import MASTER
from rossec.ros.xmlrpc import Fault
from tests.support.attacker import EVE, HOST, call, credentials, dial
from tests.support.victim import COMMAND, PARAMETER, STATE, Victim, attacked

pytestmark = [pytest.mark.ros, pytest.mark.asyncio(loop_scope="module")]


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def victim(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Victim]:
    directory: Path = tmp_path_factory.mktemp("victim")
    async with attacked(directory) as victim:
        yield victim


async def ask(victim: Victim, method: str, *params: object) -> Any:
    """What Eve, who is enrolled and has no grant, is answered."""
    answer = await call(victim.uri, credentials(victim.site), method, *params)
    await victim.goes_on(3)
    return answer


STEERING = {
    "shutdown": ("x",),
    "publisherUpdate": (COMMAND, ["http://127.0.0.1:1/"]),
    "paramUpdate": (PARAMETER, 99),
}


@pytest.mark.parametrize("method", STEERING)
@pytest.mark.parametrize("caller", [EVE, MASTER])
async def test_only_the_master_steers(victim: Victim, method: str, caller: str) -> None:
    """N1, N2, N3: the certificate counts, not what the caller calls itself."""
    code, status, _ = await ask(victim, method, caller, *STEERING[method])
    assert code == -1
    assert status == f"rossec: {method} is for the master alone"


@pytest.mark.parametrize("uris", [[], ["{evil}"]])
async def test_nobody_is_led_to_a_false_publisher(victim: Victim, uris: list[str]) -> None:
    """N2: not even a connection is made."""
    with socket.create_server((HOST, 0)) as evil:
        evil.setblocking(False)
        where = f"http://{HOST}:{evil.getsockname()[1]}/"
        named = [uri.format(evil=where) for uri in uris]
        assert (await ask(victim, "publisherUpdate", MASTER, COMMAND, named))[0] == -1
        with pytest.raises(BlockingIOError):
            evil.accept()


RECON = (
    "getBusInfo", "getBusStats", "getSubscriptions", "getPublications", "getPid", "getMasterUri",
    "getName", "getUri", "system.listMethods", "_ready", "reg_man", "rossec.revocationUpdate",
)  # fmt: skip


@pytest.mark.parametrize("method", RECON)
async def test_a_stranger_learns_nothing_of_the_node(victim: Victim, method: str) -> None:
    """N4."""
    try:
        answer = await ask(victim, method, EVE)
    except Fault as fault:
        answer = [-1, fault.faultString, 0]
    assert answer[0] == -1
    assert answer[1].startswith("rossec: ")
    assert not answer[2] or answer[2] == -1
    assert not any(word in str(answer) for word in ("state", "command", "String", victim.uri))


async def test_where_a_topic_is_does_not_tell_whether_it_is(victim: Victim) -> None:
    """N5: the grant is checked where the topic is, before a byte of it."""
    there = await ask(victim, "requestTopic", EVE, STATE, [["TCPROS"]])
    absent = await ask(victim, "requestTopic", EVE, "/robot/none", [["TCPROS"]])
    assert there == absent == [1, "ready", ["TCPROS", HOST, victim.port]]


async def test_udpros_is_not_spoken(victim: Victim) -> None:
    """N10: there is no transport that is silently plain."""
    udp = ["UDPROS", "x", HOST, 5555, 1500]
    assert (await ask(victim, "requestTopic", EVE, STATE, [udp]))[:2] == [
        -1, "rossec: only TCPROS, inside the secure channel",
    ]  # fmt: skip
    assert (await ask(victim, "requestTopic", EVE, STATE, [udp, ["TCPROS"]]))[2][0] == "TCPROS"


async def test_a_call_in_the_name_of_another_is_refused(victim: Victim) -> None:
    code, status, _ = await ask(victim, "requestTopic", "/viewer", STATE, [["TCPROS"]])
    assert (code, status) == (-1, "rossec: caller_id is not /eve")


@pytest.mark.parametrize("params", [(), (1,), (EVE,), (EVE, STATE), (EVE, STATE, "TCPROS", 3)])
async def test_malformed_calls_are_refused(victim: Victim, params: tuple[object, ...]) -> None:
    code, status, _ = await ask(victim, "requestTopic", *params)
    assert (code, status) == (-1, "Error: bad call arity or types")


async def test_one_identity_cannot_take_every_thread(victim: Victim) -> None:
    """N8: beyond the cap of one identity the others get through."""
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
