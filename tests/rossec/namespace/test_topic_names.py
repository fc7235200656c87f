"""The service behind `/get_topic_name`: what it answers, and to whom it answers meanwhile."""

import asyncio
import time
from collections.abc import AsyncIterator
from types import SimpleNamespace

import pytest

from ca.certificates import Identity
from ca.svid import build_request
from rossec.errors import AnswerRefused, ServiceFailed
from rossec.namespace.topic_names import CHILDREN, WAITING, TopicNames
from rossec.naming import rule_runner
from rossec.naming.rule_runner import RuleRunner
from tests.rossec.naming.stylesheets import sheet
from tests.support.pki import NOW, Site, new_signer

SITE = Site.create()

PHONE = rule_runner.shipped_example("phone.xml").decode()
MOBILE = "/smartphones/schneider/htc_desire/sensors/accelerometer"
SLOW = sheet(
    """<xsl:choose><xsl:when test="//slow"><xsl:for-each select="//x"><xsl:for-each select="//x">
    <xsl:for-each select="//x"><xsl:if test="count(//x) = 1">a</xsl:if></xsl:for-each>
    </xsl:for-each></xsl:for-each></xsl:when><xsl:otherwise><name>/fast</name></xsl:otherwise>
    </xsl:choose>"""
)
BOMB = f"<node><slow/>{'<x/>' * 300}</node>"


def caller(name: str = "/phone") -> Identity:
    csr = build_request(new_signer(), "home", name)
    leaf = SITE.authority.issue(csr, now=NOW, serial=7)
    return SITE.anchor.verify((leaf,), NOW)


class Parameters:
    def __init__(self) -> None:
        self.values: dict[str, object] = {}
        self.refused = False

    async def get(self, name: str) -> object:
        if self.refused:
            raise AnswerRefused("rossec: not allowed")
        return self.values.get(name, "")


def asks(name: str, metadata: str = "") -> SimpleNamespace:
    return SimpleNamespace(name=name, metadata=metadata)


@pytest.fixture
def parameters() -> Parameters:
    return Parameters()


@pytest.fixture
async def names(parameters: Parameters) -> AsyncIterator[TopicNames]:
    async with RuleRunner(rule_runner.shipped_rules(), children=2) as runner:
        yield TopicNames(runner, parameters.get)


async def test_the_name_of_a_topic(names: TopicNames) -> None:
    assert await names.answer(asks("accelerometer", PHONE), caller()) == {"topicname": MOBILE}
    temperature = {"topicname": "/building1/room3/sensors/temperature"}
    assert await names.answer(asks("temperature", PHONE), caller()) == temperature


async def test_the_name_of_a_service(names: TopicNames) -> None:
    lamp = "<node><service><name>switch</name><location>hall</location></service></node>"
    answer = await names.answer(asks("switch", lamp), caller())
    assert answer == {"topicname": "/hall/switch"}


async def test_metadata_of_the_parameter(names: TopicNames, parameters: Parameters) -> None:
    parameters.values["/phone/metadata"] = PHONE
    assert await names.answer(asks("accelerometer", " "), caller()) == {"topicname": MOBILE}
    with pytest.raises(ServiceFailed, match="there are no metadata"):
        await names.answer(asks("accelerometer"), caller("/other"))
    parameters.values["/phone/metadata"] = {"a": 1}
    with pytest.raises(ServiceFailed, match="there are no metadata"):
        await names.answer(asks("accelerometer"), caller())
    parameters.refused = True
    with pytest.raises(ServiceFailed, match="there are no metadata"):
        await names.answer(asks("accelerometer"), caller())


@pytest.mark.parametrize(
    ("which", "metadata", "error"),
    [
        ("none", PHONE, "no name for the topic 'none'"),
        ("accelerometer", "<node>", "line 1: metadata that are no XML"),
        ("accelerometer", "<!DOCTYPE a><node/>", "document type"),
        ("accelerometer", f"<node>{' ' * 300_000}</node>", "where at most 262144 are allowed"),
        ("", PHONE, "by its name"),
        ("a" * 300, PHONE, "no name of a topic"),
        ("master", "<node><topic><name>x</name></topic></node>", "no name for"),
        (
            "x",
            "<node><topic><name>x</name><location>master</location></topic></node>",
            "/master/x, which is reserved",
        ),
        (
            "x",
            "<node><service><name>x</name><location>a b</location></service></node>",
            "is not an absolute ROS name",
        ),
    ],
)
async def test_the_caller_is_told_why_there_is_no_name(
    names: TopicNames, which: str, metadata: str, error: str
) -> None:
    with pytest.raises(ServiceFailed, match=error) as caught:
        await names.answer(asks(which, metadata), caller())
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


async def test_slow_metadata_of_one_caller_delay_no_other(parameters: Parameters) -> None:
    """It asks as much as it may; the others have their answers before its first is given up."""
    mallory, others = caller("/mallory"), [caller(f"/robot{number}") for number in range(3)]
    async with RuleRunner(SLOW, children=CHILDREN, seconds=30) as runner:
        names = TopicNames(runner, parameters.get)
        asked = [asyncio.ensure_future(names.answer(asks("a", BOMB), mallory)) for _ in range(WAITING + 4)]
        await asyncio.sleep(0)
        for other in others:
            assert await names.answer(asks("a", "<node/>"), other) == {"topicname": "/fast"}
        crowded = [task for task in asked if task.done()]
        assert len(crowded) == 3, "one has its turn, and as many wait as may"
        for task in asked:
            task.cancel()
        await asyncio.gather(*asked, return_exceptions=True)


async def test_an_answer_takes_a_second_at_most(parameters: Parameters) -> None:
    async with RuleRunner(SLOW, children=1, seconds=0.2) as runner:
        names = TopicNames(runner, parameters.get)
        begin = time.monotonic()
        with pytest.raises(ServiceFailed, match="took longer than"):
            await names.answer(asks("a", BOMB), caller())
        assert time.monotonic() - begin < 20
        assert await names.answer(asks("a", "<node/>"), caller()) == {"topicname": "/fast"}
