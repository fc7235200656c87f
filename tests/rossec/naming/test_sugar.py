"""The short form, and the XSLT that somebody would write by hand."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from lxml import etree

from rossec.errors import RulesRefused
from rossec.naming.xslt import XSLT, expand
from tests.rossec.naming.stylesheets import sheet


def expanded(body: str, *, thesis_defaults: bool = False) -> etree._Element:
    root = etree.fromstring(sheet(body))
    expand(root, thesis_defaults=thesis_defaults)
    return root


def test_it_becomes_a_variable_in_its_place() -> None:
    root = expanded('a<parameter name="group" path="../g" default="unknown-group"/>b')
    assert etree.tostring(root[0]).decode() == (
        f'<xsl:template xmlns:xsl="{XSLT}" match="/">\na'
        '<xsl:variable name="group"><xsl:choose>'
        "<xsl:when test=\"normalize-space(../g) != ''\">"
        '<xsl:value-of select="normalize-space(../g)"/></xsl:when>'
        "<xsl:otherwise><xsl:text>unknown_group</xsl:text></xsl:otherwise>"
        "</xsl:choose></xsl:variable>b\n</xsl:template>\n"
    ).rstrip("\n")


def test_the_path_is_the_child_with_its_name_and_the_default_nothing() -> None:
    variable = expanded('<parameter name="location"/>')[0][0]
    assert variable[0][0].get("test") == "normalize-space(location) != ''"
    assert variable.findtext(f".//{{{XSLT}}}text") in (None, "")


@pytest.mark.parametrize(
    ("default", "text"), [("unknown-group", "unknown_group"), ("a b.c/d_1", "a_b_c/d_1"), ("é", "_")]
)
def test_a_default_has_only_characters_of_names(default: str, text: str) -> None:
    variable = expanded(f'<parameter name="a" default="{default}"/>')[0][0]
    assert variable.findtext(f".//{{{XSLT}}}text") == text
    kept = expanded(f'<parameter name="a" default="{default}"/>', thesis_defaults=True)[0][0]
    assert kept.findtext(f".//{{{XSLT}}}text") == default


def test_what_is_made_is_on_the_line_of_the_short_form() -> None:
    root = expanded('\n\n<parameter name="a"/>')
    assert {made.sourceline for made in root[0][0].iter()} == {6}


@pytest.mark.parametrize(
    ("element", "message"),
    [
        ("<parameter/>", "without a name"),
        ('<parameter name="1"/>', "without a name"),
        ('<parameter name="a" pfad="b"/>', "more than it may"),
        ('<parameter name="a">b</parameter>', "more than it may"),
        ('<parameter name="a"><b/></parameter>', "more than it may"),
        ('<parameter name="a" path=" "/>', "with an empty path"),
    ],
)
def test_another_form_is_refused_with_its_line(element: str, message: str) -> None:
    with pytest.raises(RulesRefused, match=r"^line 5: <parameter> ") as caught:
        expanded(f"\n{element}")
    assert message in str(caught.value)
    assert caught.value.hint.startswith("write <parameter name=")


WORDS = st.text(st.sampled_from("ab_/- \n\t"), max_size=6)
BY_HAND = """
<xsl:variable name="v"><xsl:choose>
  <xsl:when test="translate(/node/{path}[1], ' &#9;&#10;', '') = ''">{default}</xsl:when>
  <xsl:otherwise><xsl:value-of select="normalize-space(string(/node/{path}))"/></xsl:otherwise>
</xsl:choose></xsl:variable><name><xsl:value-of select="$v"/></name>"""


@given(
    path=st.sampled_from(["group", "owner", "topic/name"]),
    default=st.from_regex(r"[a-z_/]{0,8}", fullmatch=True),
    values=st.lists(st.tuples(st.sampled_from(["group", "owner"]), WORDS), max_size=4),
    topics=st.lists(WORDS, max_size=3),
)
def test_it_equals_what_is_written_by_hand(
    path: str, default: str, values: list[tuple[str, str]], topics: list[str]
) -> None:
    short = expanded(
        f'<parameter name="v" path="/node/{path}" default="{default}"/>'
        '<name><xsl:value-of select="$v"/></name>'
    )
    text = "".join(f"<{tag}>{value}</{tag}>" for tag, value in values)
    text += "".join(f"<topic><name>{name}</name></topic>" for name in topics)
    document = etree.fromstring(f"<node>{text}</node>")
    by_hand = etree.fromstring(sheet(BY_HAND.format(path=path, default=default)))
    assert str(etree.XSLT(short)(document)) == str(etree.XSLT(by_hand)(document))
