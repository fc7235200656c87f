"""`rossec privacy opt-out`, also on a running system."""

import asyncio
import json
import time

import pytest

from rossec.authority.home import AuthorityHome
from rossec.home import NodeHome
from rossec.master.server.server import master_of
from rossec.node import Node
from tests.support.commands import Shell, refused
from tests.support.refusingmaster import refuse_grants

POSE = "geometry_msgs/PoseStamped"


POLICY = """# The flat.
rossec: 1
robot: robbie
types: {/pose: geometry_msgs/PoseStamped}
rules:
  - {id: view, who: /viewer, why: looking, allow: {subscribe: [/pose]}}
  - {id: drive, who: /robot, allow: {publish: ["/**"]}}
"""


@pytest.fixture
def site(shell: Shell) -> Shell:
    shell.enroll("/viewer")
    (shell.root / "ca" / "policy.yaml").write_text(POLICY)
    return shell


def test_a_topic_is_denied_and_its_grants_revoked(site: Shell) -> None:
    site.unlocked("grant", "sign", "/viewer", "--subscribe", "/pose", "--publish", "/out")
    site.unlocked("grant", "sign", "/viewer", "--subscribe", "/other")
    said = site.unlocked("privacy", "opt-out", "/pose", "--master", "http://127.0.0.1:1/")
    assert said.code == 3  # no master runs here: done, but not delivered
    assert "rule opt-out-pose" in said.out
    assert said.out.count("revoked grant") == 1
    rows = json.loads(site("grant", "list", "--json").out)
    assert [row["revoked"] for row in rows] == [False, False, True]
    (kept,) = [row for row in rows[:2] if row["permissions"][0]["pattern"] == "/out"]
    assert [item["rights"] for item in kept["permissions"]] == ["publish"]
    text = (site.root / "ca" / "policy.yaml").read_text()
    assert text.startswith("# The flat.\n")
    assert "DENY" in site("explain", "/viewer", "subscribe", "/pose").out
    again = site.unlocked("privacy", "opt-out", "/pose")  # nothing left to revoke
    assert again.out == f"rule opt-out-pose-2 in {site.root}/ca/policy.yaml denies it from now on\n"


def test_a_node_is_denied_and_its_grants_revoked(site: Shell) -> None:
    site.enroll("/other")
    for node in ("/viewer", "/other"):
        site.unlocked("grant", "sign", node, "--subscribe", "/pose")
    said = site.unlocked("privacy", "opt-out", "/viewer", "--master", "http://127.0.0.1:1/")
    assert said.out.count("revoked grant") == 1
    for topic in ("/pose", "/anything"):
        assert "DENY" in site("explain", "/viewer", "subscribe", topic).out
    said = site.unlocked("privacy", "opt-out", "/stranger", "--node")
    assert said.code == 0
    assert "DENY" in site("explain", "/stranger", "subscribe", "/pose").out


def test_an_invalid_name_is_refused(site: Shell) -> None:
    refused(site.unlocked("privacy", "opt-out", "pose"), "not a name pattern")


async def test_a_running_connection_ends_at_once(site: Shell) -> None:
    """The node keeps running, hears of the revocation from the master, and sees no more."""
    for name in ("/robot", "/master"):
        await asyncio.to_thread(site.enroll, name)
    site.unlocked("grant", "sign", "/robot", "--publish", "/pose")
    site.unlocked("grant", "sign", "/viewer", "--subscribe", "/pose")
    authority = AuthorityHome.at(site.root)
    server = master_of(
        NodeHome.of(site.root, "/master"),
        host="127.0.0.1",
        port=0,
        newest=authority.revocation_list(),
        now=int(time.time()),
    )
    await server.start()
    environ = {**site.environ, "ROS_MASTER_URI": server.uri}
    try:
        async with Node("/robot", environ=environ) as robot, Node("/viewer", environ=environ) as v:
            publisher = await robot.publisher("/pose", POSE)
            subscriber = await v.subscriber("/pose", POSE)
            async with asyncio.timeout(30):
                await publisher.wait_for_subscribers()
                publisher.publish(publisher.create())
                await anext(aiter(subscriber))
            command = ("privacy", "opt-out", "/pose", "--master", server.uri)
            said = await asyncio.to_thread(site.unlocked, *command)
            assert said.code == 0, said
            assert said.out.endswith("the master has the new list\n")
            async with asyncio.timeout(30):
                while publisher.links:  # noqa: ASYNC110 - nothing tells
                    await asyncio.sleep(0.01)
            seen = subscriber.received
            publisher.publish(publisher.create())
            await asyncio.sleep(0.1)
            assert subscriber.received == seen
            # Asking again is no way round: the policy denies it now.
            await asyncio.to_thread(
                site, "grant", "request", "/viewer", "--subscribe", "/pose", "--why", "again"
            )
            said = await asyncio.to_thread(site.unlocked, "grant", "decide")
            assert said.out.endswith("\n0 allowed, 0 for you, 1 denied\n")
    finally:
        await server.close()


def test_what_the_master_refuses_is_said_after_the_revocation(
    site: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    site.unlocked("grant", "sign", "/viewer", "--subscribe", "/pose", "--publish", "/out")
    site.node("/viewer").rename(site.root / "elsewhere")
    refuse_grants(monkeypatch)
    said = site.unlocked("privacy", "opt-out", "/pose")
    assert said.code == 3
    assert "the master has the new list" in said.out
    assert "1 grant is signed, but not delivered" in said.err
