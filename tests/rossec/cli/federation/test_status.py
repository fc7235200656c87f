import asyncio
import json
from collections.abc import Mapping
from typing import Any

import pytest

from rossec.cli.master.admin import ADMIN_SOCKET
from rossec.master.operation.admin import AdminPort
from tests.support.commands import Shell, refused

ROW = {
    "label": "kitchen", "uri": "http://k:1/", "master": "/master/kitchen", "domain": "",
    "state": "lost", "facts": 7, "version": 3, "lost_s": 4.0, "error": "the peer closed",
    "parameters": [], "mirrored": 2, "source": "file",
}  # fmt: skip


def test_without_a_running_master_there_is_no_answer(empty: Shell) -> None:
    refused(empty("federation", "status"), "the master does not answer", "--admin")


async def test_the_running_master_is_asked(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[Mapping[str, Any]] = [
        {"sites": [ROW], "problems": {"site x": "two sites"}}, {"sites": [ROW], "problems": {}},
        {"sites": [], "problems": {}},
    ]  # fmt: skip
    empty.node("/master").mkdir(parents=True)
    port = AdminPort(empty.node("/master") / ADMIN_SOCKET, {"federation": lambda: answers[0]})
    await port.start()
    try:
        said = await asyncio.to_thread(empty, "federation", "status")
        assert said.out == (
            "kitchen          lost       7 facts, 2 parameters (its names are shown for a minute)"
            "  /master/kitchen at http://k:1/, by file  the peer closed\nsite x: two sites\n"
        )
        said = await asyncio.to_thread(empty, "federation", "status", "--json")
        assert json.loads(said.out) == answers[0]

        def next_answer(_: float) -> None:
            del answers[0]
            if len(answers) == 1:
                raise KeyboardInterrupt

        monkeypatch.setattr("time.sleep", next_answer)
        said = await asyncio.to_thread(empty, "federation", "status", "--watch")
        assert said.out.count("by file") == 2, "once for each change"
        said = await asyncio.to_thread(empty, "federation", "status")
        assert "no master is followed" in said.err
    finally:
        await port.close()


async def test_what_may_be_done_is_below_the_site(empty: Shell) -> None:
    empty.node("/master").mkdir(parents=True)
    answer = {"sites": [{**ROW, "hint": "is it running?"}], "problems": {}}
    port = AdminPort(empty.node("/master") / ADMIN_SOCKET, {"federation": lambda: answer})
    await port.start()
    try:
        said = await asyncio.to_thread(empty, "federation", "status")
    finally:
        await port.close()
    assert said.out.splitlines()[1] == f"{'':<16} hint: is it running?"
