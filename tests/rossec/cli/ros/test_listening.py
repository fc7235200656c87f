"""Why nothing arrives is said, once."""

import asyncio

import pytest

from rossec.cli.ros import topic
from rossec.cli.ros.topic import Arrivals, watched
from rossec.errors import ConfigurationError
from rossec.node.subscriber import RawSource
from rossec.participant.definitions import Definition
from tests.rossec.cli.ros.talking import STRING
from tests.support.site import Site

SOURCE = RawSource("/talker", Definition(STRING, "0" * 32, "string data\n"), latching=False)


def test_each_reason_is_said_once(capsys: pytest.CaptureFixture[str]) -> None:
    arrivals = Arrivals()
    for _ in range(3):
        arrivals.refused(ConfigurationError("no grant\x1b", "ask for one"))
        arrivals.refused(OSError("out of reach"))
    assert capsys.readouterr().err == ("rossec: no grant\\u001b; ask for one\nrossec: out of reach\n")


async def test_what_came_is_kept_up_to_a_number() -> None:
    arrivals = Arrivals(2)
    arrivals.connected(SOURCE)
    arrivals.received(SOURCE, [b"1", memoryview(b"2"), b"3"])  # type: ignore[list-item]  # as buffers
    messages = arrivals.messages()
    assert [(await anext(messages))[1] for _ in range(2)] == [b"2", b"3"]
    later = asyncio.ensure_future(anext(messages))
    await asyncio.sleep(0)
    arrivals.received(SOURCE, [b"4"])
    assert await later == (SOURCE, b"4")
    arrivals.disconnected(SOURCE)


@pytest.mark.parametrize("published", [True, False])
async def test_nobody_publishes(
    site: Site, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, published: bool
) -> None:
    monkeypatch.setattr(topic, "MOMENT", 0.05)
    site.publish("/talker", "/chatter")
    site.subscribe("/listener", "/chatter")
    async with site.node("/talker") as talker, site.node("/listener") as listener:
        if published:
            await talker.publisher("/chatter", STRING)
        async with watched(await listener.subscriber("/chatter", STRING)):
            await asyncio.sleep(0.3)
    assert ("nobody publishes /chatter" in capsys.readouterr().err) is not published
