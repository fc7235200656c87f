"""The standing with the master: what programs need not notice."""

from pathlib import Path

import pytest

from rossec.errors import RossecError
from tests.rossec.sidecar.conversation import Pair, connect, ends, heard
from tests.rossec.sidecar.program import Program, sidecar, word
from tests.support.site import Site
from tests.support.witness import until


async def test_a_program_returns_to_a_topic_that_it_lost(pair: Pair) -> None:
    """Stock rospy waits until the publisher is named again."""
    stream, source = await connect(pair)
    before = len(pair.listener.calls)
    source.abort()
    await ends(stream)

    def named() -> list[object]:
        calls = pair.listener.calls[before:]
        return [params[1] for method, params in calls if method == "publisherUpdate"]

    await until(lambda: named() == ["/word"], within=20)


async def test_a_restarted_master_hears_of_the_programs_again(pair: Pair) -> None:
    stream, source = await connect(pair)
    await pair.site.restart_master()
    update = "publisherUpdate"
    await until(lambda: any(method == update for method, _ in pair.listener.calls), within=30)
    await source.send(word("still"))
    assert await heard(stream, len(word("still"))) == word("still")


async def test_a_master_that_is_away_is_no_answer(tmp_path: Path) -> None:
    site = Site(tmp_path / "site")
    site.enroll("/talker")
    async with site.running(), sidecar(site) as near:
        assert site.master is not None
        await site.master.close()
        async with Program("/talker", near) as talker:
            with pytest.raises(RossecError):
                await talker.ask(talker.master_uri, "getPid")
