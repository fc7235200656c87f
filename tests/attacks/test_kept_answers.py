"""Answers that the master keeps: none outlives a right, and none is given to another caller."""

from typing import Any

import pytest

from grants.model import Right
from rossec.master.api.kept_answers import KeptAnswers
from tests.support.caller import caller, refusal
from tests.support.site import Site

KEY = "/ns/rate"


@pytest.fixture
def kept(site: Site) -> KeptAnswers:
    """What the master keeps, in a second that does not end."""
    assert site.master is not None
    now = site.now()
    site.master.state.clock = lambda: now
    return site.master._answers._kept


@pytest.mark.attack("kept-answers")
@pytest.mark.parametrize("ended", ["revoked", "expired"])
async def test_a_kept_answer_ends_with_the_right(site: Site, kept: KeptAnswers, ended: str) -> None:
    assert site.master is not None
    async with caller(site, "/bob", {KEY: Right.PARAM_GET | Right.PARAM_SET}) as bob:
        await bob("setParam", KEY, 5)
        calls = site.master.effects.calls
        for _ in range(3):
            assert await bob("getParam", KEY) == [1, f"Parameter [{KEY}]", 5]
        assert len(kept) == 1
        assert site.master.effects.calls == calls + 3, "each call counts"
        if ended == "revoked":
            held = site.enroll("/bob").grants()
            await bob("rossec.updateRevocations", site.revoke(*held))
        else:
            later = site.now() + 365 * 24 * 3600
            site.master.state.clock = lambda: later
        answer: Any = await bob("getParam", KEY)
        assert "needs the right param-get" in refusal(answer)


@pytest.mark.attack("kept-answers")
async def test_a_kept_answer_is_found_by_its_own_caller_alone(site: Site, kept: KeptAnswers) -> None:
    """Eve sends the very bytes of a call whose answer is kept, and the same question as herself."""
    assert site.master is not None
    rights = {KEY: Right.PARAM_GET | Right.PARAM_SET}
    async with caller(site, "/bob", rights) as bob, caller(site, "/eve") as eve:
        await bob("setParam", KEY, 5)
        await bob("getParam", KEY)
        await bob("getParam", KEY)
        assert len(kept) == 1
        refusal(await eve.lie("getParam", "/bob", KEY))
        denials = site.master.effects.denials
        for _ in range(3):
            await eve.refused("getParam", KEY)
        assert site.master.effects.denials == denials + 3, "each denial is for the audit"
        assert len(kept) == 1


@pytest.mark.attack("kept-answers")
async def test_a_kept_answer_ends_with_what_it_says(site: Site, kept: KeptAnswers) -> None:
    everything = {"/**": Right(255)}
    async with caller(site, "/bob", everything) as bob, caller(site, "/carl", everything) as carl:
        for value in (1, 2):
            await carl("setParam", KEY, value)
            assert [(await bob("getParam", KEY))[2] for _ in range(2)] == [value, value]
        for uri in ("rosrpc://h:1", "rosrpc://h:2"):
            await carl("registerService", "/s", uri, carl.uri)
            assert [(await bob("lookupService", "/s"))[2] for _ in range(2)] == [uri, uri]
        await carl("unregisterService", "/s", uri)
        assert (await bob("lookupService", "/s"))[0] == -1
