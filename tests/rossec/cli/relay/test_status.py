"""`rossec relay status`, against a relay that says what the test wants."""

import asyncio
import json
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest

from rossec.cli.sites import RELAY_SOCKET
from rossec.master.operation.admin import AdminPort
from tests.support.commands import Shell
from tests.support.site import Site

PEER = {
    "label": "office",
    "relay": "office:/relay",
    "state": "linked",
    "rtt_ms": 12.5,
    "retransmissions": 3,
    "router": "r",
    "streams": 2,
    "called": 1,
    "error": "",
    "hint": "",
}
BASE: dict[str, Any] = {
    "relay": "/relay",
    "domain": "home",
    "account": "home",
    "router": "tls/r:7447",
    "masters": {"/master": ""},
    "peers": [PEER],
    "forwarded_ports": 4,
    "problem": "",
}


@pytest.fixture
def shell(short_path: Path, capsys: pytest.CaptureFixture[str]) -> Shell:
    made = Shell(short_path / "home", capsys)
    Site(made.root).enroll("/relay")
    return made


class SpeakingRelay:
    """A relay's administrator's port, in a thread."""

    def __init__(self, path: Path, answer: Mapping[str, Any]) -> None:
        self.answer = answer
        self._ready, self._stop = threading.Event(), asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._path = path
        self._thread = threading.Thread(target=lambda: asyncio.run(self._run()))
        self._thread.start()
        assert self._ready.wait(10)

    async def _run(self) -> None:
        port = AdminPort(self._path, {"status": lambda: self.answer})
        await port.start()
        self._loop = asyncio.get_running_loop()
        self._ready.set()
        await self._stop.wait()
        await port.close()

    def close(self) -> None:
        assert self._loop is not None
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join()


@pytest.fixture
def relay(shell: Shell) -> Iterator[SpeakingRelay]:
    answering = SpeakingRelay(shell.node("/relay") / RELAY_SOCKET, BASE)
    yield answering
    answering.close()


@pytest.mark.usefixtures("relay")
def test_the_links_are_shown(shell: Shell) -> None:
    assert shell("relay", "status").out.splitlines() == [
        "/relay of home, account home at tls/r:7447, 4 forwarded ports",
        "/master: polled for forwarded ports",
        (
            "office           linked     office:/relay  2 connections, 1 links from it"
            "  12.5 ms, 3 retransmissions"
        ),
    ]
    assert json.loads(shell("relay", "status", "--json").out) == BASE


def test_what_is_wrong_is_shown_with_its_hint(shell: Shell, relay: SpeakingRelay) -> None:
    failed = PEER | {
        "state": "failed",
        "rtt_ms": 0,
        "called": 0,
        "streams": 0,
        "error": "nobody answers",
        "hint": "does its relay run?",
    }
    relay.answer = BASE | {
        "router": "",
        "peers": [failed],
        "masters": {"/master": "out of reach"},
        "problem": "overlay.json is not JSON",
    }
    assert shell("relay", "status").out.splitlines() == [
        "/relay of home, account home at no router is in reach, 4 forwarded ports",
        "/master: out of reach",
        "office           failed     office:/relay  0 connections  nobody answers",
        "                 hint: does its relay run?",
        "overlay.json is not JSON",
    ]


def test_a_relay_without_peers(shell: Shell, relay: SpeakingRelay) -> None:
    relay.answer = BASE | {"peers": []}
    assert "no relay of another site is known" in shell("relay", "status").err


def test_watching_shows_what_changes(
    shell: Shell, relay: SpeakingRelay, monkeypatch: pytest.MonkeyPatch
) -> None:
    answers = iter([BASE, BASE | {"forwarded_ports": 5}])

    def pause(_: float) -> None:
        try:
            relay.answer = next(answers)
        except StopIteration:
            raise KeyboardInterrupt from None

    monkeypatch.setattr("time.sleep", pause)
    said = shell("relay", "status", "--watch")
    assert said.code == 130
    assert said.out.count("office:/relay") == 2
    assert "5 forwarded ports" in said.out
