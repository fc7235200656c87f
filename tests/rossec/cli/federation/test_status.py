import asyncio
import json
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from rossec.cli.status import ADMIN_SOCKET
from rossec.master.operation.admin import AdminPort
from tests.support.commands import Shell, refused

ROW = {
    "label": "kitchen",
    "uri": "http://k:1/",
    "master": "/master/kitchen",
    "domain": "",
    "state": "lost",
    "facts": 7,
    "version": 3,
    "lost_s": 4.0,
    "error": "the peer closed",
    "parameters": [],
    "mirrored": 2,
    "source": "file",
}


def test_without_a_running_master_there_is_no_answer(empty: Shell) -> None:
    refused(empty("federation", "status"), "the master does not answer", "--admin")


async def test_the_running_master_is_asked(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    answers: list[Mapping[str, Any]] = [
        {"sites": [ROW], "problems": {"site x": "two sites"}},
        {"sites": [ROW], "problems": {}},
        {"sites": [], "problems": {}},
    ]
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


async def test_the_way_of_a_site_and_of_its_topics(empty: Shell) -> None:
    way = {
        "relay": "/relay",
        "state": "up",
        "rtt_ms": 23.41,
        "retransmissions": 2,
        "streams": 4,
        "router": "tls/router.example:7447",
    }
    topics = [f"/t{number}" for number in range(10)]
    row = {
        **ROW,
        "uri": "",
        "via": "office",
        "way": way,
        "topics": topics,
        "topics_count": 12,
        "lost_s": None,
        "error": "",
        "state": "following",
    }
    rows = [row, {**row, "way": {}, "topics": topics[:1], "topics_count": 1}]
    idle = {**way, "router": "", "rtt_ms": 0, "state": "idle"}
    rows.append({**row, "way": idle, "topics": [], "topics_count": 0})
    empty.node("/master").mkdir(parents=True)
    answer = {"sites": rows, "problems": {}}
    port = AdminPort(empty.node("/master") / ADMIN_SOCKET, {"federation": lambda: answer})
    await port.start()
    try:
        said = await asyncio.to_thread(empty, "federation", "status")
    finally:
        await port.close()
    head = "kitchen          following  7 facts, 2 parameters  /master/kitchen via office, by file"
    indent, counts = " " * 17, "2 retransmissions, 4 connections"
    assert said.out.splitlines() == [
        head,
        f"{indent}by /relay and tls/router.example:7447, up, round trip 23.4 ms, {counts}",
        f"{indent}topics: /t0 /t1 /t2 /t3 /t4 /t5 /t6 /t7 and 4 more",
        head,
        f"{indent}no relay of this site knows office",
        f"{indent}topics: /t0",
        head,
        f"{indent}by /relay, idle, {counts}",
    ]


async def test_figures_alone_do_not_show_a_site_again(empty: Shell, monkeypatch: pytest.MonkeyPatch) -> None:
    way: dict[str, Any] = {
        "relay": "/relay",
        "state": "up",
        "rtt_ms": 1.0,
        "retransmissions": 0,
        "streams": 0,
        "router": "",
    }
    row = {**ROW, "via": "office", "way": way, "topics": [], "topics_count": 0}
    empty.node("/master").mkdir(parents=True)
    answer = {"sites": [row], "problems": {}}
    port = AdminPort(empty.node("/master") / ADMIN_SOCKET, {"federation": lambda: answer})
    await port.start()
    rounds: Iterator[dict[str, Any]] = iter([{"rtt_ms": 2.0}, {"streams": 5}, {"state": "down"}])

    def next_round(_: float) -> None:
        changed = next(rounds, None)
        if changed is None:
            raise KeyboardInterrupt
        way.update(changed)

    monkeypatch.setattr("time.sleep", next_round)
    try:
        said = await asyncio.to_thread(empty, "federation", "status", "--watch")
    finally:
        await port.close()
    assert said.out.count("via office") == 2
