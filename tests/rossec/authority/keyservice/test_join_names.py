"""Names for nodes that join: rules in a process of their own, and the invitation's pattern."""

import logging

import pytest

from ca.enrollment.join import Named, RefusedMessage, RefuseReason
from rossec.authority.keyservice.network import JoinNames
from rossec.errors import RulesRefused
from rossec.naming import rule_runner

LAMP = b"<node><group>lamps</group><owner>ann</owner><name>desk</name></node>"


async def test_the_name_of_the_rules() -> None:
    async with JoinNames(rule_runner.shipped_rules()) as names:
        assert await names.answer(LAMP, "/lamps/**") == Named("/lamps/ann/desk")
        assert await names.answer(LAMP, "/lamps/ann/desk") == Named("/lamps/ann/desk")


@pytest.mark.parametrize("pattern", ["/lamps/*", "/other/**", "/lamps/ann/desk2"])
async def test_the_pattern_holds(pattern: str) -> None:
    async with JoinNames(rule_runner.shipped_rules()) as names:
        assert await names.answer(LAMP, pattern) == RefusedMessage(RefuseReason.NAME)


async def test_metadata_without_a_name_are_refused_and_the_log_says_why(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level(logging.WARNING)
    async with JoinNames(rule_runner.shipped_rules()) as names:
        for metadata in (b"<node>", b"<!DOCTYPE a><node/>", LAMP.replace(b"desk", b"a b")):
            assert await names.answer(metadata, "/**") == RefusedMessage(RefuseReason.METADATA)
        assert await names.answer(LAMP, "/**") == Named("/lamps/ann/desk")
    assert caplog.text.count("a node that joins has no name: ") == 3


async def test_without_rules_there_are_no_names() -> None:
    async with JoinNames(None) as names:
        assert await names.answer(LAMP, "/**") == RefusedMessage(RefuseReason.UNNAMED)


async def test_rules_that_are_refused_are_noticed_at_the_start() -> None:
    with pytest.raises(RulesRefused):
        async with JoinNames(b"<nothing/>"):
            pass
