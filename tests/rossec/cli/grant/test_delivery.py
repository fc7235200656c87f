"""`rossec grant list | deliver`, with a master that runs, and without one."""

import asyncio
import json
import shutil
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path

import pytest

from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from rossec.master.server.server import MasterServer, master_of
from rossec.node import Node
from tests.rossec.cli.domain.sites import Neighbours
from tests.support.commands import Said, Shell, refused
from tests.support.witness import until

NOBODY = ("--master", "http://127.0.0.1:1")


@pytest.fixture
def robot(shell: Shell) -> Shell:
    shell.enroll("/robot")
    return shell


@asynccontextmanager
async def running_master(shell: Shell) -> AsyncIterator[MasterServer]:
    shell.enroll("/master")
    home = NodeHome.of(shell.root, "/master")
    newest = AuthorityHome.at(shell.root).revocation_list()
    master = master_of(home, host="127.0.0.1", port=0, newest=newest, now=int(time.time()))
    await master.start()
    try:
        yield master
    finally:
        await master.close()


def states(said: Said) -> list[tuple[str, str]]:
    return [(row["node"], row["state"]) for row in json.loads(said.out)]


def test_a_right_with_several_restrictions_is_listed_once(robot: Shell) -> None:
    robot.unlocked(
        "grant",
        "sign",
        "/robot",
        "--subscribe",
        "/q",
        "--type",
        "geometry_msgs/PoseStamped",
        "--preset",
        "coarse-position",
        "--rate",
        "5",
    )
    assert robot("grant", "list", *NOBODY).out.count("subscribe /q") == 1


def test_the_list_marks_revoked_grants(robot: Shell) -> None:
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    robot.unlocked("grant", "sign", "/robot", "--subscribe", "/q")
    first, second = (line.split()[0] for line in robot("grant", "list").out.splitlines())
    said = robot.unlocked("grant", "revoke", first[:8], *NOBODY)
    assert f"revoked {first}" in said.out
    refused(said, "did not take the list", "rossec ca publish", code=3)
    listed = json.loads(robot("grant", "list", "/robot", "--json", *NOBODY).out)
    assert [(row["id"], row["revoked"], row["state"]) for row in listed] == [
        (second, False, "delivered"),
        (first, True, "revoked"),
    ]
    assert robot("grant", "list", *NOBODY).out.splitlines()[1].endswith(" UTC  revoked")
    assert robot("grant", "list", "/other").out == ""


def test_without_a_master_the_list_says_what_it_knows(robot: Shell) -> None:
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p")
    said = robot("grant", "list", *NOBODY)
    assert said.out.strip().endswith("delivered")
    assert said.err == "", "the grant is in the node's directory: no master has to be asked"
    shutil.rmtree(robot.node("/robot") / "grants")
    said = robot("grant", "list", *NOBODY)
    assert said.code == 0
    assert said.out.strip().endswith("unknown")
    assert said.err.startswith("rossec: whether nodes have their grants is unknown: the master at")
    refused(robot("grant", "deliver", *NOBODY), "did not take the grant", "grant deliver", code=3)


def test_a_grant_that_has_ended_is_expired(robot: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    robot.unlocked("grant", "sign", "/robot", "--publish", "/p", "--for", "1h")
    monkeypatch.setattr("rossec.cli.grant.delivery.now", lambda: int(time.time()) + 3600)
    said = robot("grant", "list", *NOBODY)
    assert said.out.strip().endswith("expired")
    assert said.err == ""


async def test_a_grant_for_a_node_elsewhere_arrives_through_the_master(robot: Shell) -> None:
    """Signed while the master is off, deposited later, fetched by a node with its own home."""
    elsewhere = robot.root / "elsewhere"
    (elsewhere / "nodes").mkdir(parents=True, mode=0o700)
    elsewhere.chmod(0o700)
    shutil.move(robot.node("/robot"), elsewhere / "nodes" / "robot")
    sign = ("grant", "sign", "/robot", "--publish", "/p")
    said = await asyncio.to_thread(robot.unlocked, *sign, *NOBODY)
    assert said.code == 0
    assert "deliver it when the master runs: rossec grant deliver" in said.err
    async with running_master(robot) as master:

        async def command(*words: str) -> Said:
            return await asyncio.to_thread(robot, *words, "--master", master.uri)

        assert states(await command("grant", "list", "--json")) == [("/robot", "undelivered")]
        delivered = await command("grant", "deliver")
        assert delivered.out == "the master has the grant, and gives it to the node\n"
        assert (await command("grant", "deliver")).out == "the master has every grant in force\n"
        assert states(await command("grant", "list", "--json")) == [("/robot", "waiting")]
        environ = {"ROSSEC_HOME": str(elsewhere), "ROS_MASTER_URI": master.uri, "ROS_IP": "127.0.0.1"}
        async with Node("/robot", environ=environ) as node:
            await node.publisher("/p", "std_msgs/String")
            assert states(await command("grant", "list", "--json")) == [("/robot", "held")]
            said = await asyncio.to_thread(
                robot.unlocked, "grant", "sign", "/robot", "--subscribe", "/q", "--master", master.uri
            )
            assert said.out.endswith("the master has the grant, and gives it to the node\n")
            await until(lambda: len(node.home.grants()) == 2)
            await node.subscriber("/q", "std_msgs/String")


def test_a_grant_for_another_domain_is_listed_by_its_label(visit: Neighbours, tmp_path: Path) -> None:
    certificate = visit.hospital.node("/rounds/robot3") / "node.pem"
    said = visit.shell.unlocked(
        "grant",
        "sign",
        "hospital:/rounds/robot3",
        "--subscribe",
        "/pose",
        "--certificate",
        str(certificate),
        "--out",
        str(tmp_path / "x.grant"),
    )
    assert said.code == 0, said.err
    listed = visit.shell("grant", "list", "--master", "http://127.0.0.1:1").out
    assert "  hospital:/rounds/robot3  subscribe /pose  " in listed


async def test_a_master_in_another_home_gets_the_list_with_the_first_grant(robot: Shell) -> None:
    """It has received none, and refuses every grant without one."""
    robot.enroll("/master")
    shutil.move(robot.node("/robot"), robot.root / "elsewhere")
    home = NodeHome.of(robot.root, "/master")
    master = master_of(home, host="127.0.0.1", port=0, newest=None, now=int(time.time()))
    await master.start()
    try:
        sign = ("grant", "sign", "/robot", "--publish", "/p", "--master", master.uri)
        said = await asyncio.to_thread(robot.unlocked, *sign)
        assert (said.code, said.err) == (0, "")
        assert said.out.endswith("the master has the grant, and gives it to the node\n")
    finally:
        await master.close()


async def test_a_grant_that_the_master_refuses_is_no_success(
    robot: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("rossec.master.rights.held_grants.MAX_HELD", 0)
    shutil.move(robot.node("/robot"), robot.root / "elsewhere")
    async with running_master(robot) as master:
        sign = ("grant", "sign", "/robot", "--publish", "/p", "--json", "--master", master.uri)
        said = await asyncio.to_thread(robot.unlocked, *sign)
        assert said.code == 3
        found = json.loads(said.out)
        assert [each["node"] for each in found["refused"]] == ["/robot"]
        assert found["error"] == "1 grant is signed, but not delivered"
        said = await asyncio.to_thread(robot, "grant", "deliver", "--master", master.uri)
        assert said.code == 3
        assert said.err.startswith("rossec: the master refuses the grant ")
        assert "rossec: hint: afterwards deliver it with: rossec grant deliver" in said.err
