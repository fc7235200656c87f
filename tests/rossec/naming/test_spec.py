"""docs/spec/namespace.md lists what rules may use, what is reserved and the limits, as they are."""

import re
from pathlib import Path

from lxml import etree

from rossec.naming import child, requests, rule_runner, xslt
from rossec.naming.xslt import XSLT, expand
from tests.rossec.naming.stylesheets import sheet

SPEC = (Path(__file__).parents[3] / "docs" / "spec" / "namespace.md").read_text()
FLAT = " ".join(SPEC.split())


def between(start: str, end: str) -> set[str]:
    """The words in back quotes between two texts."""
    return set(re.findall(r"`([^`]+)`", FLAT.partition(start)[2].partition(end)[0]))


def test_the_reserved_names() -> None:
    assert between("MUST NOT be one of", ": identities") == requests.RESERVED


def test_the_functions() -> None:
    assert between("; of EXSLT", "of strings.") == xslt.STRING_FUNCTIONS
    assert between("functions of XPath 1.0 and", "; of EXSLT") <= xslt.ALLOWED
    refused = between("of strings. So not", "In an attribute value template")
    assert len(refused) == 6
    assert not refused & xslt.ALLOWED


def test_the_elements() -> None:
    refused = between("elements of XSLT 1.0 but for", "; elements without")
    assert len(refused) == 4
    assert not refused & xslt._ELEMENTS
    assert f"`{xslt.STRINGS}`" in FLAT


def test_the_limits() -> None:
    assert f"| processor time | {child.CPU} s |" in SPEC
    assert f"| wall clock | {rule_runner.SECONDS:g} s, or less" in SPEC
    assert f"| memory | {child.MEMORY >> 20} MB of addresses |" in SPEC
    assert f"| metadata, rules, launch file | {requests.MAX_INPUT >> 10} KiB each |" in SPEC
    assert f"| answer | {requests.MAX_ANSWER >> 20} MiB; a name 255 characters |" in SPEC
    assert f"At most {requests.MAX_ENTRIES} topics and services" in SPEC


def test_the_short_form_is_what_the_text_shows() -> None:
    shown = SPEC.partition("```xml\n<xsl:variable")[2].partition("```")[0]
    by_text = etree.fromstring(sheet(f"<xsl:variable{shown}"), etree.XMLParser(remove_blank_text=True))
    root = etree.fromstring(sheet('<parameter name="N" path="P" default="D"/>'))
    expand(root)
    made, written = (next(each.iter(f"{{{XSLT}}}variable")) for each in (root, by_text))
    assert etree.tostring(made).strip() == etree.tostring(written).strip()


def test_the_example_is_metadata() -> None:
    text = SPEC.partition("```xml\n")[2].partition("```")[0]
    assert [entry.name for entry in requests.read(text.encode()).entries] == ["accelerometer", "reset"]
    assert requests.read(rule_runner.shipped_example("phone.xml")).owner == requests.read(text.encode()).owner
