"""What rules may not consist of, with the line."""

import pytest
from lxml import etree

from rossec.errors import RulesRefused
from rossec.naming import rule_runner
from rossec.naming.xslt import scan
from tests.rossec.naming.stylesheets import gives, sheet

EXSLT = 'xmlns:x="http://exslt.org/{}"'


def test_the_shipped_rules_pass() -> None:
    scan(etree.fromstring(rule_runner.shipped_rules()))


@pytest.mark.parametrize(
    "rules",
    [
        gives("str:tokenize('a b')[1]", attributes='xmlns:str="http://exslt.org/strings"'),
        gives("'document(1)'"),
        sheet('<a b="{normalize-space(c)}" d="$(find e) f(g)"/>'),
        sheet("<!-- document('a') --><a/>"),
        sheet("", top='<xsl:key name="k" match="a" use="b"/>'),
    ],
)
def test_harmless_rules_pass(rules: bytes) -> None:
    scan(etree.fromstring(rules))


@pytest.mark.parametrize(
    ("rules", "what"),
    [
        (gives("document('/etc/passwd')"), "the function document()"),
        (gives("document('')"), "the function document()"),
        (gives("generate-id()"), "the function generate-id()"),
        (gives("system-property('xsl:vendor')"), "the function system-property()"),
        (gives("unparsed-entity-uri('a')"), "the function unparsed-entity-uri()"),
        (gives("x:node-set(a)", attributes=EXSLT.format("common")), "the namespace"),
        (gives("x:evaluate(a)", attributes=EXSLT.format("dynamic")), "the namespace"),
        (gives("x:date()", attributes=EXSLT.format("dates-and-times")), "the namespace"),
        (gives("x:match(a)", attributes=EXSLT.format("regular-expressions")), "the namespace"),
        (gives("x:f(a)", attributes=EXSLT.format("strings")), "the function x:f()"),
        (gives("y:padding(a)"), "the function y:padding()"),
        (sheet('<x:document href="a"/>', attributes=EXSLT.format("common")), "the namespace"),
        (sheet("<x:padding/>", attributes=EXSLT.format("strings")), "an extension element"),
        (sheet("<ns:a xmlns:ns='urn:schemas-tum-de:vmi:ns'/>"), "the namespace"),
        (sheet("<saxon:a xmlns:saxon='http://icl.com/saxon'/>"), "the namespace"),
        (sheet("<xsl:document href='a'/>"), "<xsl:document>"),
        (sheet("<xsl:fallback/>"), "<xsl:fallback>"),
        (sheet("", top='<xsl:import href="a"/>'), "<xsl:import>"),
        (sheet("", top='<xsl:include href="a"/>'), "<xsl:include>"),
        (sheet("", top="<xsl:namespace-alias/>"), "<xsl:namespace-alias>"),
        (sheet("<?xml-stylesheet href='a'?>"), "a processing instruction"),
        (sheet("<a b=\"{document('c')}\"/>"), "the function document()"),
        (sheet('<a xsl:extension-element-prefixes="b"/>'), "the attribute extension-element"),
        (sheet("<xsl:for-each select='document(a)'/>"), "the function document()"),
        (sheet("", top="<xsl:key name='k' match='a' use='document(b)'/>"), "the function document"),
        (sheet("", attributes='extension-element-prefixes="xsl"'), "the attribute extension"),
    ],
)
def test_what_rules_may_not_use_is_refused(rules: bytes, what: str) -> None:
    with pytest.raises(RulesRefused, match=r"^line \d: rules may not use ") as caught:
        scan(etree.fromstring(rules))
    assert what in str(caught.value)
    assert "XSLT 1.0" in caught.value.hint


def test_the_line_is_that_of_the_element() -> None:
    with pytest.raises(RulesRefused, match=r"^line 5: "):
        scan(etree.fromstring(sheet("<a/>\n<xsl:value-of select='document(1)'/>")))
