import pytest

from rossec.errors import MetadataRefused
from rossec.namespace.launch_file import MAX_DEPTH, scan
from rossec.naming.requests import NameKind
from tests.rossec.namespace.launch_texts import FIGURES, NS, launch, node, topic

FIGURE = (FIGURES / "phones.launch").read_bytes()


def test_the_nodes_of_the_figure() -> None:
    first, second = scan(FIGURE).nodes
    assert (first.name, first.line, second.name) == ("htc_desire", 3, "htc_desire2")
    assert [(kind, name, source) for _, kind, name, source in first.entries()] == [
        (NameKind.TOPIC, "accelerometer", "~accelerometer"),
        (NameKind.TOPIC, "wallwasher", "~output2"),
    ]
    assert second.metadata() == (
        b"<node><name>htc_desire2</name><owner>schneider</owner><group>smartphones</group>"
        b"<topic><name>accelerometer</name><function>sensor</function><mobile>true</mobile>"
        b"</topic></node>"
    )


def test_positions_are_those_of_the_bytes() -> None:
    data = b"\xef\xbb\xbf<?xml version='1.0'?>\n" + launch(
        f'  <!-- é -->\n  <node  name = \'lämp\'\n  pkg="a>b" type="t" >{topic()}</node>\n'
    )
    (found,) = scan(data).nodes
    span = found.tag.span
    assert data[span.start : span.end] == '<node  name = \'lämp\'\n  pkg="a>b" type="t" >'.encode()
    value = found.tag.values["name"]
    assert data[value.start : value.end] == "lämp".encode()
    assert data[found.tag.insertion :].startswith(b">")
    whole = found.elements[0].whole
    assert data[whole.start : whole.end] == topic().encode()


def test_positions_in_latin_1() -> None:
    head = b'<?xml version="1.0" encoding="ISO-8859-1"?>\n'
    text = launch("<!-- \xe9\xe9\xe9 -->", node("<ns:group>g</ns:group>")).decode()
    data = head + text.encode("iso-8859-1")
    (found,) = scan(data).nodes
    whole = found.elements[0].whole
    assert data[whole.start : whole.end] == b"<ns:group>g</ns:group>"


def test_what_is_empty_and_what_is_nested() -> None:
    text = '<a:group xmlns:a="urn:schemas-tum-de:vmi:ns"/><ns:x><ns:y>1 &amp; 2</ns:y></ns:x>'
    data = launch("<group ns='g'>", node(text), "</group>")
    (found,) = scan(data).nodes
    first, second = (data[e.whole.start : e.whole.end].decode() for e in found.elements)
    assert first + second == text
    assert found.metadata() == (b"<node><name>lamp</name><group></group><x><y>1 &amp; 2</y></x></node>")


def test_what_is_no_launch_file_is_refused() -> None:
    with pytest.raises(MetadataRefused, match=r"^line 1: a launch file is a <launch>, not <node>"):
        scan(b"<node/>")


def test_nodes_without_metadata_are_nobody_s_business() -> None:
    data = launch('<node name="$(arg x)" pkg="p" type="t" ns="a"/>', node(name=""))
    assert scan(data).nodes == []


def test_includes() -> None:
    data = launch("<include file='$(dirname)/a.launch'/>\n<include/>")
    (found,) = scan(data).includes
    assert (found.file, found.line) == ("$(dirname)/a.launch", 2)
    assert data[found.value.start : found.value.end] == b"$(dirname)/a.launch"


@pytest.mark.parametrize(
    ("data", "error"),
    [
        (b"<launch>\n<node>", "line 2: a launch file that is no XML: "),
        (b"<!DOCTYPE launch><launch/>", "line 1: a launch file with a document type"),
        (b'<?xml version="1.0" encoding="utf-16"?><launch/>', "encoding"),
        (b"", "empty a launch file|empty"),
        (launch("<ns:group>a</ns:group>"), "line 2: <group> of the metadata is not inside"),
        (launch("<test test-name='a'><ns:group/></test>"), "not inside a <node>"),
        (launch(node("<ns:group><b/></ns:group>")), "line 3: <b> is inside metadata"),
        (launch(node("<ns:name>a</ns:name>")), "line 3: the name of a node is that of"),
        (launch(node(topic(), more=' ns="a"')), "line 2: the node 'lamp' has metadata and ns="),
        (launch(node(topic(), name="$(arg name)")), "whose name is not written out"),
        (launch(node(topic(), name="")), "whose name is not written out"),
        (launch(node("<ns:group>$(env G)</ns:group>")), r"line 3: <group> has \$\(...\)"),
        (launch(node("<ns:group a='1'/>")), "has an attribute it may not have"),
        (launch(node("<ns:topic type='~a'><ns:name type='~a'/></ns:topic>")), "an attribute"),
        (launch(node("<ns:x>a<ns:y/></ns:x>")), "has text beside elements"),
        (launch("<a>" * MAX_DEPTH, "</a>" * MAX_DEPTH), "nested deeper"),
        (launch("<a>\x07</a>"), "no XML"),
    ],
)
def test_what_is_refused(data: bytes, error: str) -> None:
    with pytest.raises(MetadataRefused, match=error):
        scan(data)


@pytest.mark.parametrize(
    ("metadata", "error"),
    [
        ("<ns:topic type='~a'/>", "line 3: a topic of 'lamp' without <name>"),
        ("<ns:service type='~a'><ns:name> </ns:name></ns:service>", "a service of 'lamp' without"),
        (topic(source=""), "without the name that it replaces"),
        ("<ns:topic><ns:name>a</ns:name></ns:topic>", "without the name that it replaces"),
        (topic(source="a b"), "without the name that it replaces"),
        (topic(source="$(arg a)"), "without the name that it replaces"),
        (f"<remap from='~state' to='/x'/>{topic()}", "~state of 'lamp' is remapped already"),
    ],
)
def test_topics_that_make_no_sense(metadata: str, error: str) -> None:
    (found,) = scan(launch(node(metadata))).nodes
    with pytest.raises(MetadataRefused, match=error):
        found.entries()


def test_a_huge_tag_is_read_in_one_pass() -> None:
    tag = "a" * 100_000
    data = launch(f"<{tag}/>", f"<b {tag}='{tag[:50_000]}'/>", node(topic()))
    assert len(scan(data).nodes) == 1


def test_what_may_have_a_namespace_of_its_own() -> None:
    data = f'<l:launch xmlns:l="urn:other" {NS}><l:node name="a"/></l:launch>'.encode()
    assert scan(data).nodes == []
