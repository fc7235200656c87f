"""docs/howto/from-rostopic.md: ROS 1's tools and rossec's, row by row, on the same graph."""

import re
import shlex
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, Final

import pytest

from rossec.cli.shared.messages import parse_documents
from tests.integration.sidecarworld import DEADLINE, ROSSEC, World, wait
from tests.support.hosts import two_hosts
from tests.support.site import Site

pytestmark = [pytest.mark.ros, pytest.mark.timeout(300)]

TEXT: Final = (Path(__file__).parents[2] / "docs/howto/from-rostopic.md").read_text()
ROWS: Final = [
    tuple(match) for match in re.findall(r"^\| `(ros.+?)` \| `rossec (.+?)` \|", TEXT, re.MULTILINE)
]
SOON: Final = "8"  # seconds for what has no end of its own


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("tools")
    with two_hosts() as hosts:
        world = World(hosts, Site(directory / "site"), directory)
        for tool in ("/rostopic", "/rosnode", "/rosservice", "/rosparam", "/me"):
            world.enroll(
                tool,
                wildcard=tool != "/me",
                subscribe="/**",
                publish="/said /turn /at",
                call="/**",
                graph="/**",
            )
        world.enroll("/hearer", subscribe="/**")
        world.enroll("/robot", publish="/robot/**", provide="/robot/**", param_set="/robot/**")
        program = Path(__file__).parents[1] / "support" / "robotprogram.py"
        with (
            world.master(),
            world.started(
                hosts.near, Path(ROSSEC).with_name("python").as_posix(), "-I", str(program)
            ) as robot,
        ):
            robot.wait_for("the robot is ready")
            yield world


def stock(world: World, command: str, *, ends: bool = True) -> str:
    """What ROS 1's tool prints, behind a sidecar."""
    words = shlex.split(command)
    if ends:
        return world.tool(*words)
    done = world.run(world.hosts.far, "timeout", "-s", "INT", SOON, *words)
    return done.stdout


def ours(world: World, command: str, *options: str) -> str:
    """What the command of the right column prints."""
    done = subprocess.run(
        world.hosts.far.at(ROSSEC, *shlex.split(command), "--as", "/me", *options),
        env=world.env(world.hosts.far),
        text=True,
        capture_output=True,
        timeout=DEADLINE,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def of_robot(text: str) -> list[str]:
    """Lines about the robot: each tool is a node itself while it asks."""
    lines = [re.sub(r"( at http.*| ?\(http.*\))$", "", line).strip() for line in text.splitlines()]
    return sorted(line for line in lines if "/robot" in line and "logger" not in line)


def alike(world: World, left: str, right: str) -> None:
    found = of_robot(ours(world, right))
    assert found == of_robot(stock(world, left))
    assert found


def same(world: World, left: str, right: str) -> None:
    assert ours(world, right).split() == stock(world, left).split()


def messages(world: World, left: str, right: str) -> None:
    """But for the counter in them, both print the same."""
    shown = [re.sub(r"seq: [0-9]+", "seq:", text) for text in (ours(world, right), stock(world, left))]
    assert shown[0] == shown[1].replace("1e-05", "1.0e-05")
    assert len(parse_documents(shown[0].replace("seq:", "seq: 0"))) == 2


def figures(world: World, left: str, right: str) -> None:
    """Numbers differ, words do not."""
    said = [ours(world, right, "-n", "4"), stock(world, left, ends=False)]
    shapes = [
        {re.sub(r"[0-9]+", "0", line) for line in text.splitlines() if "window: " in line} for text in said
    ]
    assert shapes[0]
    assert {re.sub("0+", "0", line)[:5] for line in shapes[0]} == {
        re.sub("0+", "0", line)[:5] for line in shapes[1]
    }


def published(world: World, left: str, right: str) -> None:
    """What is published is the same message."""
    topic, kind = shlex.split(right)[3:5]
    heard = [
        listened(world, topic, kind, lambda: stock(world, left)),
        listened(world, topic, kind, lambda: ours(world, right)),
    ]
    shown = [re.sub(r"(n?secs): *[0-9]+", r"\1: 0", text) for text in heard]
    shown = [re.sub(r"seq: [0-9]+", "seq: 0", text) for text in shown]
    assert shown[0] == shown[1]


def listened(world: World, topic: str, kind: str, publish: Callable[[], Any]) -> str:
    command = (ROSSEC, "topic", "echo", topic, kind, "--as", "/hearer", "-n", "1")
    with world.started(world.hosts.near, *command) as hearer:
        hearer.wait_for("waiting")
        publish()
        wait(lambda: hearer.process.poll() is not None)
        return hearer.said.split("waiting\n", 1)[1]


WAYS: Final = {
    ("rostopic", "list"): alike,
    ("rostopic", "info"): alike,
    ("rosnode", "list"): alike,
    ("rostopic", "type"): same,
    ("rostopic", "find"): alike,
    ("rosnode", "info"): alike,
    ("rostopic", "echo"): messages,
    ("rostopic", "hz"): figures,
    ("rostopic", "bw"): figures,
    ("rostopic", "pub"): published,
    ("rosservice", "list"): alike,
    ("rosservice", "type"): same,
    ("rosservice", "call"): same,
    ("rosparam", "list"): alike,
    ("rosparam", "get"): same,
}


def test_there_are_rows() -> None:
    assert len(ROWS) == 20


@pytest.mark.parametrize(("left", "right"), ROWS)
def test_the_row_holds(world: World, left: str, right: str) -> None:
    tool, verb = left.split()[:2]
    WAYS[tool, verb](world, left, right)
