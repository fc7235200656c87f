"""Rules tried on the metadata of several nodes."""

import sys

import pytest

from rossec.errors import RulesNotConfined
from rossec.naming import requests
from rossec.naming.examine import Covered, MetadataFinding, MetadataReport, examine
from rossec.naming.requests import NameKind
from rossec.naming.rule_runner import RuleProcess, RuleRunner
from tests.rossec.naming.stylesheets import PHONE, RULES, gives, sheet

LAMP = b"""<node>
<name>lamp</name>
<topic><name>temperature</name><function>sensor</function><location>building1/room3</location>
</topic>
<topic><name>state</name><location>a-b</location></topic>
<service><name>reset</name><location>remote</location></service>
</node>"""


async def examined(
    rules: bytes, *documents: bytes, covered: Covered | None = None
) -> tuple[MetadataReport, list[tuple[str, int, str]]]:
    async with RuleRunner(rules) as runner:
        named = [(f"{n}.xml", document) for n, document in enumerate(documents)]
        report = await examine(runner, named, covered)
    return report, [(found.file, found.line, found.what) for found in report.findings]


async def test_the_shipped_rules_and_metadata_have_no_findings() -> None:
    report, found = await examined(RULES, PHONE)
    assert found == []
    assert sorted(name for _, name in report.names) == [
        "/building1/room3/sensors/temperature",
        "/smartphones/schneider/htc_desire",
        "/smartphones/schneider/htc_desire/sensors/accelerometer",
    ]


async def test_collisions_and_illegal_names_are_found_with_their_lines() -> None:
    report, found = await examined(RULES, PHONE, LAMP)
    assert found == [("1.xml", 3, "collision"), ("1.xml", 5, "illegal"), ("1.xml", 6, "illegal")]
    assert str(report.findings[0]) == (
        "1.xml:3: the topic temperature: /building1/room3/sensors/temperature is also the topic"
        " temperature in 0.xml:13"
    )
    assert "'/a-b/state' is not an absolute ROS name" in str(report.findings[1])
    assert "/remote/reset, which is reserved" in str(report.findings[2])


async def test_a_topic_and_a_service_of_one_name_do_not_collide() -> None:
    text = b"<node><topic><name>a</name></topic><service><name>a</name></service></node>"
    assert (await examined(RULES, text))[1] == []


async def test_metadata_that_cannot_be_read_do_not_end_the_others() -> None:
    report, found = await examined(RULES, b"<node>", PHONE, b"<robot/>")
    assert found == [("0.xml", 1, "metadata"), ("2.xml", 1, "metadata")]
    assert len(report.names) == 3


async def test_where_no_rules_can_be_applied_nothing_is_reported() -> None:
    async with RuleRunner(RULES) as runner:
        process = unconfined()
        runner._take = lambda: process  # type: ignore[method-assign]
        with pytest.raises(RulesNotConfined, match="no seccomp"):
            await examine(runner, [("a.xml", PHONE)])


def unconfined() -> RuleProcess:
    said = requests.frame(requests.write_error(RulesNotConfined("no seccomp")))
    return RuleProcess([sys.executable, "-I", "-c", f"import os; os.write(1, {said!r})"])


async def test_rules_that_fail_for_some_are_told() -> None:
    failing = gives("concat('/', $missing)")
    assert (await examined(failing, b"<node/>"))[1] == [("0.xml", 1, "rules")]
    silent = sheet("")
    assert (await examined(silent, b"<node/>"))[1] == [("0.xml", 1, "undefined")]
    again = '<xsl:call-template name="a"/>'
    endless = sheet(again, top=f'<xsl:template name="a">{again}</xsl:template>')
    assert (await examined(endless, b"<node/>"))[1] == [("0.xml", 1, "rules")]


async def test_a_name_that_depends_on_the_order_is_found() -> None:
    """The middle of three stays the middle when they are turned round."""
    middle = gives("concat('/', /node/topic[2]/name)")
    text = b"<node><topic><name>a</name></topic>\n<topic><name>b</name></topic>"
    document = text + b"<topic><name>c</name></topic></node>"
    report, found = await examined(middle, document)
    assert ("0.xml", 1, "order") in found
    assert "/b, but in another order of the same metadata /" in str(report.findings[-1])


async def test_an_order_in_which_there_is_no_name_is_found() -> None:
    first = sheet("<xsl:if test=\"name(/node/*[1]) = 'name'\"><name>/a</name></xsl:if>")
    report, found = await examined(first, b"<node><name>a</name><group>b</group></node>")
    assert found == [("0.xml", 1, "order")]
    assert "/a, but in another order of the same metadata no name (" in str(report.findings[0])


async def test_names_that_nothing_covers_are_found() -> None:
    asked: list[tuple[str, NameKind, str]] = []

    def covered(node: str, kind: NameKind, name: str) -> bool:
        asked.append((node, kind, name))
        return kind is not NameKind.TOPIC or name.startswith("/smartphones")

    report, found = await examined(RULES, PHONE, covered=covered)
    assert found == [("0.xml", 13, "uncovered")]
    assert str(report.findings[0]).endswith(
        "no grant or rule covers /building1/room3/sensors/temperature for /smartphones/schneider/htc_desire"
    )
    assert {node for node, _, _ in asked} == {"/smartphones/schneider/htc_desire"}


def test_findings_are_sorted_by_file_and_line() -> None:
    one, two = MetadataFinding("a", 2, "order", "x"), MetadataFinding("a", 10, "illegal", "x")
    assert sorted([two, one]) == [one, two]
