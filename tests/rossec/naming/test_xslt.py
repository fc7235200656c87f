"""Rules applied: the thesis's names, and each way in which rules or metadata fail."""

from pathlib import Path

import pytest

from rossec.errors import MetadataRefused, NameUndefined, RossecError, RulesExceeded, RulesRefused
from rossec.naming import requests, rule_runner, xslt
from rossec.naming.requests import NameKind, NameRequest
from tests.rossec.naming.stylesheets import NODE, PHONE, RULES, gives, request, sheet


def only(asked: NameRequest) -> requests.Result:
    """The one result of a request; what refuses all of it is raised."""
    (result,) = requests.read_names(xslt.answer(asked), 1)
    return result


def names(document: bytes, *queries: tuple[NameKind, str], rules: bytes = RULES) -> list[requests.Result]:
    body = xslt.answer(NameRequest(rules, document, queries))
    return requests.read_names(body, len(queries))


def test_the_names_of_the_thesis() -> None:
    """Figures 4.1, A.1 and A.3, and the node's name of section A.2.1."""
    topics = ((NameKind.TOPIC, "accelerometer"), (NameKind.TOPIC, "temperature"))
    assert names(PHONE, NODE, *topics) == [
        "/smartphones/schneider/htc_desire",
        "/smartphones/schneider/htc_desire/sensors/accelerometer",
        "/building1/room3/sensors/temperature",
    ]


@pytest.mark.parametrize(
    ("text", "query", "name"),
    [
        ("", NODE, "/unknown_group/unknown_node"),
        ("<group>g</group><name>n</name>", NODE, "/g/n"),
        ("<owner> </owner><group>g</group><name>n</name>", NODE, "/g/n"),
        ("<topic><name>t</name></topic>", (NameKind.TOPIC, "t"), "/unknown_location/t"),
        (
            "<topic><name>t</name><mobile>true</mobile><function>lamp</function></topic>",
            (NameKind.TOPIC, "t"),
            "/unknown_group/unknown_node/lamps/t",
        ),
        (
            "<topic><name>t</name></topic><service><name>t</name><location>r</location></service>",
            (NameKind.SERVICE, "t"),
            "/r/t",
        ),
    ],
)
def test_what_is_not_said_has_a_default(text: str, query: tuple[NameKind, str], name: str) -> None:
    assert names(f"<node>{text}</node>".encode(), query) == [name]


def test_the_rules_as_printed_have_no_slashes() -> None:
    """Figure A.3 lost them in print; the file that is shipped has them."""
    printed = RULES.replace(b"<xsl:text>/</xsl:text>", b"<xsl:text></xsl:text>")
    assert names(PHONE, NODE, rules=printed) == ["smartphonesschneiderhtc_desire"]


def test_the_defaults_of_the_thesis_are_kept_where_they_are_asked_for() -> None:
    asked = NameRequest(RULES, b"<node/>", (NODE,), thesis_defaults=True)
    assert only(asked) == "/unknown-group/unknown-node"


def test_a_value_is_text_and_never_an_expression() -> None:
    which = "' or '1'='1"
    assert isinstance(names(PHONE, (NameKind.TOPIC, which))[0], NameUndefined)
    quoted = f'<node><topic><name>{which}"</name></topic></node>'.encode()
    assert names(quoted, (NameKind.TOPIC, which + '"')) == [f'/unknown_location/{which}"']


@pytest.mark.parametrize(
    ("rules", "error", "message"),
    [
        (sheet("<name>/a</name><name>/b</name>"), NameUndefined, "give more than one name"),
        (sheet("<xsl:comment>a</xsl:comment><name>/a</name>"), NameUndefined, "more than one name"),
        (sheet("/a"), NameUndefined, "give no name for the node"),
        (sheet("<nom>/a</nom>"), RulesRefused, "give <nom> for the node, not one <name>"),
        (sheet("<name><a/></name>"), RulesRefused, "give <name> for the node, not one <name>"),
        (gives("concat(a, 1, 2)", top=""), str, "12"),
        (
            gives("string(str:padding(2000, 'a'))", attributes='xmlns:str="http://exslt.org/strings"'),
            RulesExceeded,
            "a name of 2000 characters",
        ),
        (gives("$missing"), RulesRefused, "the rules failed"),
        (sheet('<xsl:call-template name="nobody"/>'), RulesRefused, "the rules failed"),
        (sheet('<xsl:message terminate="yes">no group</xsl:message>'), RulesRefused, "no group"),
    ],
)
def test_what_the_rules_give(rules: bytes, error: type[object], message: str) -> None:
    found = only(request(rules))
    assert isinstance(found, error)
    assert message in str(found)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        (b"<a", "line 1: rules that are no XML"),
        (b"\n<a></b>", "line 2: rules that are no XML"),
        (b"<!DOCTYPE a>", "line 1: rules with a document type"),
        (b"<node/>", "rules are an <xsl:stylesheet>, not <node>"),
        (sheet("").replace(b'"1.0"', b'"2.0"'), "line 1: rules are of version 1.0"),
        (sheet('\n<xsl:value-of select="a +"/>'), "line 5: rules that are no XSLT 1.0: "),
        (sheet('<parameter name="a" path="b["/>'), "line 4: rules that are no XSLT 1.0: "),
        (sheet('<parameter name="a" path="document(1)"/>'), "line 4: rules may not use"),
        (sheet("<parameter/>"), "line 4: <parameter> without a name"),
    ],
)
def test_rules_that_are_none_are_refused_for_all(rules: bytes, message: str) -> None:
    with pytest.raises(RulesRefused) as caught:
        only(request(rules))
    assert message in str(caught.value)


@pytest.mark.parametrize("document", [b"<node>", b"<!DOCTYPE a><a/>", b"<a>&b;</a>"])
def test_metadata_that_are_none_are_refused(document: bytes) -> None:
    with pytest.raises(MetadataRefused):
        only(request(RULES, document))


def test_rules_alone_are_compiled() -> None:
    assert requests.read_names(xslt.answer(NameRequest(RULES, b"")), 0) == []
    with pytest.raises(RulesRefused):
        requests.read_names(xslt.answer(NameRequest(b"<a/>", b"")), 0)


def test_no_memory_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def compile_rules(*_: object, **__: object) -> None:
        raise MemoryError

    monkeypatch.setattr(xslt, "compile_rules", compile_rules)
    with pytest.raises(RulesExceeded, match="more memory than allowed"):
        only(request(RULES))


def test_nothing_is_opened_even_by_rules_that_were_not_scanned(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """The second line: libxslt's own access control."""
    monkeypatch.setattr(xslt, "scan", lambda _: None)
    secret = tmp_path / "secret.xml"
    secret.write_text("<name>/secret</name>")
    for rules in (
        sheet(f"<xsl:copy-of select=\"document('{secret}')/name\"/>"),
        sheet("<xsl:copy-of select=\"document('')/*\"/>"),
        sheet("", top=f'<xsl:import href="{secret}"/>'),
        sheet("", top=f'<xsl:include href="{secret}"/>'),
        sheet(
            f'<e:document href="{secret}.out">a</e:document>',
            attributes='xmlns:e="http://exslt.org/common" extension-element-prefixes="e"',
        ),
    ):
        found: object
        try:
            found = only(request(rules))
        except RossecError as error:
            found = error
        assert isinstance(found, RossecError)
    assert list(tmp_path.iterdir()) == [secret]


def test_the_shipped_example_is_the_print() -> None:
    assert rule_runner.shipped_example("phone.xml").startswith(b'<?xml version="1.0" encoding="ISO-8859-1"?>')
