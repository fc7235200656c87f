"""`rossec gateway status`: lines for people, and what it says when no gateway runs."""

import asyncio
import contextlib
import json
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from rossec.cli import status
from rossec.cli import status as module
from rossec.master.operation.admin import AdminPort
from tests.support.commands import Shell, refused
from tests.support.site import Site

TOPIC = {
    "topic": "ada:/robot/pose",
    "served": "/gateway/ada/robot/pose",
    "type": "std_msgs/String",
    "state": "subscribed",
    "subscribers": 3,
    "publishers": 1,
    "messages": 7,
    "octets": 70,
    "problem": "",
}
TOLD: dict[str, Any] = {
    "gateway": "/gateway",
    "problem": "",
    "topics": [TOPIC, {**TOPIC, "problem": "a reason"}],
    "rules": [
        {"from": "ada", "pattern": "/robot/**", "rate": 2.5, "newest": True, "compress": True},
        {"from": "ben", "pattern": "/x", "rate": None, "newest": False, "compress": False},
    ],
    "skipped": [
        {"topic": "ada:/a", "why": "not granted", "hint": "sign it"},
        {"topic": "ada:/b", "why": "/gateway/attic serves it", "hint": ""},
    ],
    "skipped_count": 5,
}


@contextlib.contextmanager
def answering(path: Path, answer: Callable[[], dict[str, Any]]) -> Iterator[None]:
    """A gateway that answers so, in a thread."""
    ready, loop, ends = threading.Event(), asyncio.new_event_loop(), asyncio.Event()

    async def serve() -> None:
        port = AdminPort(path, {"status": answer})
        await port.start()
        ready.set()
        await ends.wait()
        await port.close()

    thread = threading.Thread(target=loop.run_until_complete, args=(serve(),))
    thread.start()
    try:
        assert ready.wait(20)
        yield
    finally:
        loop.call_soon_threadsafe(ends.set)
        thread.join()
        loop.close()


@pytest.fixture
def near(short_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    """A home in a directory whose path is short enough for a socket, with a gateway."""
    shell = Shell(short_path / "h", capsys)
    Site(shell.root).enroll("/gateway")
    return shell


def test_what_is_served_and_what_not(near: Shell) -> None:
    with answering(near.node("/gateway") / module.ADMIN_SOCKET, lambda: TOLD):
        lines = near("gateway", "status").out.splitlines()
        row = (
            "ada:/robot/pose (std_msgs/String) as /gateway/ada/robot/pose  subscribed,"
            " 3 here, 1 there, 7 messages, 70 bytes"
        )
        assert lines == [
            "/gateway",
            "  from ada: /robot/**, 2.5 messages a second, the newest only, compressed",
            "  from ben: /x",
            row,
            row,
            "  a reason",
            "ada:/a is not served: not granted",
            "  hint: sign it",
            "ada:/b is not served: /gateway/attic serves it",
            "and 3 more are not served",
        ]
        assert json.loads(near("gateway", "status", "--json").out) == TOLD


def test_a_graph_that_is_not_known_and_nothing_served(near: Shell) -> None:
    told = {**TOLD, "problem": "no grant", "topics": [], "skipped": [], "skipped_count": 0}
    with answering(near.node("/gateway") / module.ADMIN_SOCKET, lambda: told):
        said = near("gateway", "status")
    assert said.out.startswith("/gateway: the graph cannot be followed: no grant\n")
    assert "nothing is served" in said.err


def test_it_is_shown_again_when_it_changes(near: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(status, "PERIOD", 0.01)
    answers = [{**TOLD, "skipped_count": count} for count in (2, 2, 3)]
    with answering(near.node("/gateway") / module.ADMIN_SOCKET, lambda: answers.pop(0)):
        said = near("gateway", "status", "--watch")
    assert said.out.count("more are not served") == 1
    assert said.out.count("from ben") == 2


def test_no_gateway_answers(empty: Shell) -> None:
    refused(empty("gateway", "status"), "the gateway does not answer", "rossec gateway")
