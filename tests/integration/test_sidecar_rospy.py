"""Unmodified rospy programs and the libraries built on it, each behind its own sidecar.

The client runs twice: behind a sidecar, and in-process.
"""

import contextlib
import sys
from collections.abc import Iterator

import pytest

from tests.integration.sidecarworld import Running, World, wait
from tests.support import rospyuse
from tests.support.fleet import SECURE
from tests.support.hosts import Host, Hosts
from tests.support.site import Site

pytestmark = [pytest.mark.ros, pytest.mark.timeout(180)]


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Iterator[World]:
    directory = tmp_path_factory.mktemp("sidecar_rospy")
    loopback = Host((), "127.0.0.1", "::1")
    site = Site(directory / "site")
    world = World(Hosts(loopback, loopback, real=False), site, directory)
    world.enroll("/basics", publish="/basics/*", provide="/basics/*", param_set="/basics/*")
    world.enroll("/asker", subscribe="/basics/*", call="/basics/*", param_set="/asker/*")
    world.enroll(
        "/worker",
        subscribe="/chore/goal /chore/cancel",
        publish="/chore/status /chore/feedback /chore/result",
    )
    world.enroll(
        "/boss", publish="/chore/goal /chore/cancel", subscribe="/chore/status /chore/feedback /chore/result"
    )
    world.enroll("/mount", publish="/tf /tf_static")
    own = "/looker/tf2_frames"  # of tf2's buffer, which looks it up first
    world.enroll("/looker", subscribe="/tf /tf_static", provide=own, call=own)
    world.enroll("/drive", publish="/drive/*", provide="/drive/*", param_set="/drive/*")
    world.enroll("/tuner", subscribe="/drive/*", call="/drive/*")
    with world.master():
        yield world


@contextlib.contextmanager
def serving(world: World, source: str, ready: str = "READY") -> Iterator[Running]:
    with world.secured(world.hosts.near, sys.executable, "-c", source) as running:
        running.wait_for(ready)
        yield running


def said(world: World, source: str) -> Iterator[list[str]]:
    """The output of a program behind a sidecar, then in-process."""
    yield world.tool(sys.executable, "-c", source).splitlines()
    with world.started(world.hosts.near, sys.executable, "-c", SECURE + source) as running:
        wait(lambda: running.process.poll() is not None)
    yield running.said.splitlines()


def test_rospy_messages_services_and_parameters_work(world: World) -> None:
    source = rospyuse.BASICS_SERVER
    with world.secured(world.hosts.near, sys.executable, "-c", source):
        for lines in said(world, rospyuse.BASICS_CLIENT):
            assert lines[0].startswith("HEARD word ")
            assert lines[1:] == [
                "ANSWERED /basics",
                "KEPT [True, False]",
                "COLOUR [1, 2.5, True]",
                "OWN 7 False /asker/mine",
                "DELETED gone",
                "IN ORDER True",
            ]


def test_an_action_reaches_its_goal_or_is_cancelled(world: World) -> None:
    """actionlib's client may log a change of an earlier goal: a race in actionlib."""
    with serving(world, rospyuse.ACTION_SERVER):
        for lines in said(world, rospyuse.ACTION_CLIENT):
            assert [line for line in lines if "we're not tracking" not in line] == [
                "SERVER True",
                "FINISHED True",
                "RESULT 42  [0, 1, 2]",
                "FINISHED True",
                "CANCELLED True",
            ]


def test_static_transforms_are_latched(world: World) -> None:
    with serving(world, rospyuse.TF_BROADCASTER):
        for lines in said(world, rospyuse.TF_LISTENER):
            assert lines == ["CAMERA AT 2.5"]


def test_a_node_is_reconfigured(world: World) -> None:
    """Its configuration is latched; 9 is above its maximum."""
    with serving(world, rospyuse.RECONFIGURE_SERVER) as drive:
        before = ["1.5", "3.0"]
        for was, lines in zip(before, said(world, rospyuse.RECONFIGURE_CLIENT), strict=True):
            assert lines == [f"BEFORE {was}", "AFTER 3.0"]
        drive.wait_for("SPEED 3.0")
