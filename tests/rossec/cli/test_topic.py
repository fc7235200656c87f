"""`rossec topic` and `rossec master`, as processes: a user's first conversation."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from rossec.cli import topic
from rossec.errors import ConfigurationError
from rossec.node.messages import message_type
from tests.support.commands import Shell, refused
from tests.support.site import Site

STRING = "std_msgs/String"


def start(site: Site, environ: dict[str, str], *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-I", "-m", "rossec", *arguments],
        env={**os.environ, "ROSSEC_HOME": str(site.root), "ROS_IP": "127.0.0.1", **environ},
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip


@pytest.fixture
def site(tmp_path: Path) -> Site:
    site = Site(tmp_path / "site")
    site.publish("/talker", "/chatter")
    site.subscribe("/listener", "/chatter")
    listed = site.authority.store.newest_list()
    assert listed is not None
    site.enroll("/master").save_revocations(listed)
    return site


@pytest.fixture
def master(site: Site) -> Iterator[dict[str, str]]:
    process = start(site, {}, "master", "--port", "0")
    assert process.stdout is not None
    said = process.stdout.readline()
    assert said.startswith("master of home at http://127.0.0.1:")
    yield {"ROS_MASTER_URI": said.split()[-1]}
    process.send_signal(signal.SIGTERM)
    _, complaints = process.communicate(timeout=60)
    assert process.returncode == 0, complaints


def test_what_is_said_is_heard(site: Site, master: dict[str, str]) -> None:
    talk = ("topic", "pub", "/chatter", STRING, "{data: hello}", "--as", "/talker", "--rate", "20")
    talker = start(site, master, *talk)
    listener = start(
        site, master, "topic", "echo", "/chatter", STRING, "--as", "/listener", "-n", "2"
    )
    out, err = listener.communicate(timeout=30)
    assert (listener.returncode, out, err) == (0, "data: hello\n---\n" * 2, "")
    talker.send_signal(signal.SIGINT)
    _, said = talker.communicate(timeout=60)
    assert (talker.returncode, said) == (130, "rossec: waiting for a subscriber of /chatter\n\n")


def test_a_listener_without_a_grant_hears_why(site: Site, master: dict[str, str]) -> None:
    process = start(site, master, "topic", "echo", "/secret", STRING, "--as", "/listener")
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (1, "")
    assert err.startswith("rossec: error: ")
    assert "subscribe" in err.splitlines()[0]
    assert "Traceback" not in err


def test_no_master_is_said(site: Site, empty: Shell) -> None:
    environ = {"ROS_MASTER_URI": "http://127.0.0.1:1"}
    process = start(site, environ, "topic", "echo", "/chatter", STRING, "--as", "/listener")
    _, err = process.communicate(timeout=30)
    assert process.returncode == 1
    assert err.startswith("rossec: error: cannot connect to 127.0.0.1 port 1")
    said = empty("topic", "echo", "/chatter", STRING, "--as", "/nobody")
    refused(said, "/nobody has no", "rossec node request /nobody")


def filled(type_name: str, content: object) -> Any:
    message = message_type(type_name).create()
    topic.fill(message, content)
    return message


def test_messages_are_written_as_in_rostopic() -> None:
    message = filled("geometry_msgs/PoseStamped", {"pose": {"position": {"x": 1}}})
    assert message.pose.position.x == 1.0
    assert isinstance(message.pose.position.x, float)
    scan = filled("sensor_msgs/LaserScan", {"ranges": [1, 2.5], "header": {"frame_id": "laser"}})
    assert scan.ranges.dtype == np.float32
    assert "header:\n  seq: 0\n  stamp:\n    sec: 0" in topic.render(scan)


def test_text_of_a_peer_stays_on_its_line() -> None:
    assert topic.render(filled(STRING, {"data": "a\n---\ndata: \x1b[2J\u202eb"})) == (
        "data: a\\n---\\ndata: \\u001b[2J\\u202eb"
    )


def test_arrays_are_shown_as_in_rostopic() -> None:
    scan = filled("sensor_msgs/LaserScan", {"ranges": [1, 2.5] * 1000})
    assert "\nranges: [1.0, 2.5, 1.0, 2.5," in topic.render(scan)
    assert "\nintensities: []" in topic.render(scan)
    image = filled("sensor_msgs/Image", {"data": [1, 255]})
    assert topic.render(image).endswith("\ndata: [1, 255]")
    joints = message_type("sensor_msgs/JointState").create()
    joints.name = ["left", "a\n', '"]
    assert "\nname: ['left', 'a\\n', '']\n" in topic.render(joints)
    path = message_type("nav_msgs/Path").create()
    assert topic.render(path).endswith("\nposes: []")
    path.poses = [filled("geometry_msgs/PoseStamped", {"header": {"frame_id": "map"}})] * 2
    assert topic.render(path).count("\n  -\n    header:\n      seq: 0\n") == 2


@pytest.mark.parametrize(
    ("content", "error"),
    [
        ("text", "a message is a mapping"),
        ({"poze": 1}, "no field 'poze' in geometry_msgs/PoseStamped"),
        ({"pose": 7}, "a message is a mapping"),
        ({"header": {"seq": "many"}}, "seq"),
        ({"header": {"frame_id": 5}}, "frame_id"),
    ],
)
def test_a_message_that_is_none(content: object, error: str) -> None:
    with pytest.raises(ConfigurationError, match=error):
        filled("geometry_msgs/PoseStamped", content)


def test_content_that_is_no_yaml(empty: Shell) -> None:
    refused(empty("topic", "pub", "/chatter", STRING, "{data: [", "--as", "/talker"), "is no YAML")


def test_a_complaint_is_written_down(site: Site, tmp_path: Path) -> None:
    log = tmp_path / "complaints"
    process = start(site, {}, "master", "--port", "0", "--complaints", str(log))
    assert process.stdout is not None
    uri = process.stdout.readline().split()[-1]
    echo = ("topic", "echo", "/secret", STRING, "--as", "/listener")
    start(site, {"ROS_MASTER_URI": uri}, *echo).communicate(timeout=30)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert '"node": "/listener", "right": "subscribe", "name": "/secret"' in log.read_text()
