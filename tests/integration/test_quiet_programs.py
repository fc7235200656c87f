"""No line of refusal on any screen for programs that do nothing wrong, and one a cause for others.

Debian's programs with a policy as a user writes it, put in force by the commands a user runs.
"""

import contextlib
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import pytest

from tests.integration.sidecarworld import ROSSEC, Running, wait
from tests.integration.test_first_steps import Home
from tests.support.ports import free_port
from tests.support.xserver import x_server

pytestmark = [pytest.mark.ros, pytest.mark.timeout(240)]

BASICS: Final = """rossec: 1
robot: home
basics: [tf]
types: {/chatter: std_msgs/String}
"""
RULES: Final = """rules:
  - {id: talk, who: /talker, allow: {publish: [/chatter]}}
  - {id: look, who: /rostopic, allow: {subscribe: [/chatter], graph: [/**]}}
  - id: rviz
    who: /rviz
    allow:
      subscribe: [/markers, /markers_array]
      publish: [/initialpose, /goal, /move_base_simple/goal, /clicked_point]
      provide: ["{node}/*"]
tests:
  - {who: /talker, may: {publish: /chatter}, may_not: {publish: /cmd_vel, subscribe: /**}}
  - {who: /rostopic, may_not: {publish: /**}, sees: {/chatter: {data: exact}}}
"""
TALKER: Final = """
import rossec
rossec.secure()
import rospy
from std_msgs.msg import String
rospy.init_node("talker")
publisher = rospy.Publisher("/chatter", String, queue_size=10)
while not rospy.is_shutdown():
    publisher.publish("hello")
    rospy.sleep(0.1)
"""
REFUSALS: Final = ("may not", "refuse", "FATAL", "needs the right", "unable to register", "couldn't register")


class Site:
    """One home on this host: an authority, a master, and nodes with and without a tail."""

    def __init__(self, home: Home, policy: str) -> None:
        self.root = home.path
        uri = f"http://127.0.0.1:{free_port()}"
        home.variables["ROS_MASTER_URI"] = uri
        home.done(*home.secret("ca", "init", "home", "--master"))
        for name in ("/talker", "/rostopic", "/rviz"):
            tail = () if name == "/talker" else ("--anonymous",)
            home.done("node", "request", name, *tail)
            node = self.root / "nodes" / name[1:]
            request = str(node / "node.csr")
            home.done(*home.secret("ca", "sign", request, "--yes", *tail))
            home.done("node", "install", "--yes", str(node / "node.pem"))
        (self.root / "ca" / "policy.yaml").write_text(policy)
        home.done(*home.secret("policy", "apply", "--yes"))
        kept = {key: value for key, value in os.environ.items() if not key.startswith("ROS")}
        self.env = {
            **kept,
            **home.variables,
            "ROS_HOME": str(self.root),
            "ROS_LOG_DIR": str(self.root),
            "PYTHONUNBUFFERED": "1",
            "PYTHONWARNINGS": "ignore",
        }

    @contextlib.contextmanager
    def started(self, *command: str) -> Iterator[Running]:
        running = Running(command, self.env)
        try:
            yield running
        finally:
            running.close()

    @contextlib.contextmanager
    def master(self) -> Iterator[Running]:
        log = str(self.root / "denials")
        with self.started(ROSSEC, "master", "--denial-log", log) as master:
            master.wait_for("master of home at")
            yield master

    def ends(self, *command: str) -> str:
        """All that a program says until it ends well."""
        with self.started(*command) as running:
            wait(lambda: running.process.poll() is not None)
        assert running.process.returncode == 0, running.said
        return running.said

    def wait_for_topic(self) -> None:
        """Until the talker publishes: before that a listener says that nobody does."""
        listing = (ROSSEC, "topic", "list", "--as", "/rostopic")
        wait(lambda: "/chatter" in self.ends(*listing))

    def denials(self) -> list[dict[str, object]]:
        return [json.loads(line) for line in (self.root / "denials").read_text().splitlines()]

    def audit(self) -> str:
        [file] = (self.root / "nodes" / "master").glob("audit*")
        return file.read_text()


@pytest.fixture
def home(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> Home:
    return Home(tmp_path / "home", capsys)


def check_quiet(*said: str) -> None:
    for text in said:
        assert [word for word in REFUSALS if word in text] == [], text


def test_programs_that_do_nothing_wrong_are_refused_nothing(home: Home) -> None:
    site = Site(home, BASICS + RULES)
    with site.master() as master, site.started(sys.executable, "-c", TALKER) as talker, rviz(site) as viewer:
        site.wait_for_topic()
        heard = site.ends(ROSSEC, "run", "--", "rostopic", "echo", "-n", "2", "/chatter")
        assert heard == 'data: "hello"\n---\n' * 2
        built_in = ("topic", "echo", "/chatter", "std_msgs/String", "--as", "/rostopic")
        check_quiet(site.ends(ROSSEC, *built_in, "--count", "1"))
        listing = (ROSSEC, "run", "--as", "/rostopic", "--", "rosservice", "list")
        wait(lambda: "/save_config" in site.ends(*listing))
        check_quiet(talker.said, viewer.said, master.said, site.audit())
    assert site.denials() == []


@contextlib.contextmanager
def rviz(site: Site) -> Iterator[Running]:
    with site.started(*x_server()) as display:
        wait(lambda: display.said.strip().isdecimal())
        where = f"DISPLAY=:{display.said.strip()}"
        with site.started(ROSSEC, "run", "--", "env", where, "rviz") as running:
            yield running


def test_without_basics_a_program_works_and_no_warning_says_what_it_works_without(home: Home) -> None:
    site = Site(home, BASICS.replace("basics: [tf]", "basics: false") + RULES)
    with site.master() as master, site.started(sys.executable, "-c", TALKER) as talker:
        site.wait_for_topic()
        heard = site.ends(ROSSEC, "run", "--", "rostopic", "echo", "-n", "2", "/chatter")
        assert heard == 'data: "hello"\n---\n' * 2
        check_quiet(talker.said)
        forbidden = ("rostopic", "pub", "-1", "/cmd_vel", "std_msgs/String", "x")
        with site.started(ROSSEC, "run", "--", *forbidden) as refused:
            rule = "an allow rule for /rostopic with publish: [/cmd_vel] would change it"
            refused.wait_for(f"/rostopic may not publish /cmd_vel: {rule}")
            assert "/rosout" not in refused.said
        wait(lambda: "/cmd_vel" in master.said)
        lines = [line for line in master.said.splitlines() if "may not" in line]
    assert [line.partition(" may not ")[0] for line in lines] == ["rossec: WARNING: /rostopic"]
    assert "basics: true" not in master.said, "it works without: no warning"
