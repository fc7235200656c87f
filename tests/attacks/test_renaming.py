"""A node says of itself what it likes, and asks which names it gets: it gains no right.

Metadata are claims. Grants and policies speak of resulting names, so the name that rules give is
judged as if the node had made it up.
"""

import asyncio
import string
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ca.names import pattern_covers
from grants.errors import GrantMissing
from grants.model import Right
from rossec.errors import RossecError
from rossec.naming.requests import NameKind
from rossec.naming.rule_runner import RuleRunner
from rossec.participant.access import Access
from tests.rossec.naming.stylesheets import RULES
from tests.rossec.participant.test_access import field, revocations
from tests.support.caller import caller
from tests.support.domains import alone
from tests.support.site import Site

EVE = "/phones/eve/phone"
OWN = "/phones/eve/**"
TYPE = "std_msgs/String"
pytestmark = pytest.mark.attack("rules-rights")


def claims(owner: str, group: str, location: str, *, mobile: bool) -> bytes:
    return (
        f"<node><owner>{owner}</owner><group>{group}</group><name>phone</name><topic>"
        f"<name>place</name><location>{location}</location><mobile>{str(mobile).lower()}</mobile>"
        "</topic></node>"
    ).encode()


async def test_a_name_that_claims_gave_is_registered_only_with_a_grant(site: Site) -> None:
    async with caller(site, EVE, {OWN: Right.PUBLISH}) as eve, RuleRunner(RULES) as rules:
        for document, name, is_allowed in (
            (claims("eve", "phones", "x", mobile=True), "/phones/eve/phone/place", True),
            (claims("mallory", "phones", "x", mobile=True), "/phones/mallory/phone/place", False),
            (claims("eve", "robots", "x", mobile=True), "/robots/eve/phone/place", False),
            (claims("eve", "phones", "robot", mobile=False), "/robot/place", False),
            (claims("eve", "phones", "phones/eve", mobile=False), "/phones/eve/place", True),
        ):
            assert await rules.name(document, NameKind.TOPIC, "place") == name
            if is_allowed:
                answer = await eve("registerPublisher", name, TYPE, eve.uri)
                assert answer[0] == 1, answer
            else:
                said = await eve.refused("registerPublisher", name, TYPE, eve.uri)
                assert name in said


WORDS = st.sampled_from(["eve", "phones", "robot", "mallory", "phones/eve", "eve/phone", "*", "**"])
CLAIMS = WORDS | st.text(string.ascii_letters + "/_*", max_size=12)


def test_whatever_is_claimed_a_right_is_that_of_the_name(tmp_path: Path) -> None:
    now = int(time.time())
    site = Site(tmp_path / "site", clock=lambda: now)
    site.enroll(EVE)
    held = field(site.grant(EVE, Right.PUBLISH, OWN))
    access = Access(alone(site.anchor, revocations(site, now)))
    identity, seen = site.identity(EVE), set[bool]()

    @settings(max_examples=100, suppress_health_check=[HealthCheck.filter_too_much])
    @given(CLAIMS, CLAIMS, CLAIMS, st.booleans())
    def check(owner: str, group: str, location: str, mobile: bool) -> None:
        document = claims(owner, group, location, mobile=mobile)
        try:
            name = loop.run(rules.name(document, NameKind.TOPIC, "place"))
        except RossecError:
            return
        try:
            access.authorize(identity, held, Right.PUBLISH, name, now)
        except GrantMissing:
            is_allowed = False
        else:
            is_allowed = True
        seen.add(is_allowed)
        assert is_allowed is pattern_covers(OWN, name)

    rules = RuleRunner(RULES)
    with asyncio.Runner() as loop:
        loop.run(rules.__aenter__())
        try:
            check()
        finally:
            rules.close()
    assert seen == {True, False}
