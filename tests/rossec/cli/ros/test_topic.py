"""`rossec topic` and `rossec master`, as processes: a user's first conversation."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from rossec.cli.ros.topic import Messages
from rossec.participant.message_types import message_type
from tests.support.commands import Shell, refused
from tests.support.site import Site

STRING = "std_msgs/String"


def start(site: Site, environ: dict[str, str], *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-I", "-m", "rossec", *arguments],
        env={**os.environ, "ROSSEC_HOME": str(site.root), "ROS_IP": "127.0.0.1", **environ},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


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


def test_a_published_message_is_echoed(site: Site, master: dict[str, str]) -> None:
    talk = ("topic", "pub", "/chatter", STRING, "{data: hello}", "--as", "/talker", "--rate", "20")
    talker = start(site, master, *talk)
    listener = start(site, master, "topic", "echo", "/chatter", STRING, "--as", "/listener", "-n", "2")
    out, err = listener.communicate(timeout=30)
    assert (listener.returncode, out, err) == (0, 'data: "hello"\n---\n' * 2, "")
    talker.send_signal(signal.SIGINT)
    _, said = talker.communicate(timeout=60)
    assert (talker.returncode, said) == (130, "rossec: waiting for a subscriber of /chatter\n\n")


def test_the_type_need_not_be_given(site: Site, master: dict[str, str]) -> None:
    talk = ("topic", "pub", "/chatter", STRING, "hello", "--as", "/talker", "--rate", "20")
    talker = start(site, master, *talk)
    listener = start(site, master, "topic", "echo", "/chatter", "--as", "/listener", "-n", "1")
    out, err = listener.communicate(timeout=30)
    assert (listener.returncode, out, err) == (0, 'data: "hello"\n---\n', "")
    shown = start(site, master, "topic", "echo", "/chatter", "--as", "/listener", "-n", "1", "--nostr")
    assert shown.communicate(timeout=30)[0] == 'data: "<string length: 5>"\n---\n'
    talker.send_signal(signal.SIGINT)
    talker.communicate(timeout=60)


def test_a_listener_hears_that_nobody_publishes(site: Site, master: dict[str, str]) -> None:
    for kind in ((), (STRING,)):
        words = ("topic", "echo", "/chatter", *kind, "--as", "/listener")
        listener = start(site, master, *words)
        assert listener.stderr is not None
        assert listener.stderr.readline() == ("rossec: nobody publishes /chatter at this master; waiting\n")
        listener.send_signal(signal.SIGINT)
        assert "".join(listener.communicate(timeout=60)).strip() == ""


def test_what_was_echoed_is_published_again(site: Site, master: dict[str, str], tmp_path: Path) -> None:
    recorded = tmp_path / "recorded.yaml"
    recorded.write_text('data: "one"\n---\ndata: two\n---\n')
    talk = ("topic", "pub", "/chatter", STRING, "-f", str(recorded), "--as", "/talker", "-r", "20")
    listener = start(site, master, "topic", "echo", "/chatter", STRING, "--as", "/listener", "-n", "2")
    talker = start(site, master, *talk)
    out, _ = listener.communicate(timeout=30)
    _, said = talker.communicate(timeout=60)
    assert (out, talker.returncode) == ('data: "one"\n---\ndata: "two"\n---\n', 0), said


def test_files_and_arguments_that_are_no_messages(empty: Shell, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("---\n")
    command = ("topic", "pub", "/chatter", STRING, "--as", "/talker", "-f", str(file))
    refused(empty(*command), "holds no message", "one or more")
    refused(empty(*command, "{data: x}"), "exclude each other", code=2)


def test_a_message_of_now_is_made_each_time_anew() -> None:
    messages = Messages(message_type("std_msgs/Time"), [{"data": "now"}, {"data": 5}])
    first, again = messages.at(0), messages.at(2)
    assert first is not again
    assert messages.at(1) is messages.at(3)
    assert first.data.sec > 1_700_000_000


def test_a_listener_without_a_grant_hears_why(site: Site, master: dict[str, str]) -> None:
    process = start(site, master, "topic", "echo", "/secret", STRING, "--as", "/listener")
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out) == (1, "")
    assert err.startswith("rossec: error: ")
    assert "subscribe" in err.splitlines()[0]
    assert "Traceback" not in err


def test_a_missing_master_is_reported(site: Site, empty: Shell) -> None:
    environ = {"ROS_MASTER_URI": "http://127.0.0.1:1"}
    process = start(site, environ, "topic", "echo", "/chatter", STRING, "--as", "/listener")
    _, err = process.communicate(timeout=30)
    assert process.returncode == 1
    assert err.startswith("rossec: error: cannot connect to 127.0.0.1 port 1")
    said = empty("topic", "echo", "/chatter", STRING, "--as", "/nobody")
    refused(said, "/nobody has no", "rossec node request /nobody")


def test_a_complaint_is_written_down(site: Site, tmp_path: Path) -> None:
    log = tmp_path / "denial_log"
    process = start(site, {}, "master", "--port", "0", "--denial-log", str(log))
    assert process.stdout is not None
    uri = process.stdout.readline().split()[-1]
    echo = ("topic", "echo", "/secret", STRING, "--as", "/listener")
    start(site, {"ROS_MASTER_URI": uri}, *echo).communicate(timeout=30)
    process.send_signal(signal.SIGTERM)
    process.communicate(timeout=60)
    assert '"node": "/listener", "right": "subscribe", "name": "/secret"' in log.read_text()
