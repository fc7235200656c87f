from collections.abc import Sequence
from xml.etree import ElementTree

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rossec.errors import MetadataRefused, NameUndefined
from rossec.naming.requests import NameKind
from tests.rossec.namespace.launch_texts import launch, node, simple, topic, transform

WORDS = st.text("abcdefghij", min_size=1, max_size=8)


def made(*inside: str) -> str:
    return transform(launch(*inside), simple)[0].decode()


def test_metadata_become_a_namespace_and_remappings() -> None:
    found = made(node("<ns:group>lamps</ns:group>", topic("light", "~out")))
    assert found == launch(node('<remap from="~out" to="/lamps/lamp/light"/>', more=' ns="/lamps"')).decode()


def test_the_names_are_reported() -> None:
    _, (found,) = transform(launch(node("<ns:group>g</ns:group>", topic("light", "~out"))), simple)
    (entry,) = found.entries
    assert (found.line, found.name) == (2, "/g/lamp")
    assert (entry.kind, entry.source, entry.name) == (NameKind.TOPIC, "~out", "/g/lamp/light")


@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_only_lines_without_anything_else_are_left_out(end: str) -> None:
    text = end.join(
        (
            '<launch xmlns:ns="urn:schemas-tum-de:vmi:ns">',
            '\t<node name="lamp" pkg="p" type="t"><!-- one --><ns:owner>o</ns:owner>',
            "\t\t<ns:group>g</ns:group>  <ns:function>f</ns:function> ",
            "\t\t<ns:comment>",
            "\t\t\tlong</ns:comment><!-- two -->",
            '\t\t<ns:service type="call"><ns:name>s</ns:name></ns:service></node>',
            "</launch>",
        )
    )
    found, _ = transform(text.encode(), simple)
    assert found.decode() == end.join(
        (
            '<launch xmlns:ns="urn:schemas-tum-de:vmi:ns">',
            '\t<node name="lamp" pkg="p" type="t" ns="/g"><!-- one -->',
            "\t\t<!-- two -->",
            '\t\t<remap from="call" to="/g/lamp/s"/></node>',
            "</launch>",
        )
    )


def test_another_name_of_the_node_is_put_in_its_place() -> None:
    def renamed(metadata: bytes, queries: Sequence[tuple[NameKind, str]]) -> list[str]:
        return ["/top" if kind is NameKind.NODE else "/t" for kind, _ in queries]

    found, _ = transform(launch(node("<ns:group/>")), renamed)
    assert found == launch(node(name="top", more=' ns="/"'))


def test_a_file_without_metadata_is_the_same() -> None:
    data = launch("<!-- x -->", '<node name="$(anon a)" pkg="p" type="t"/>', "<group/>")
    assert transform(data, simple) == (data, [])


def test_two_nodes_with_one_name() -> None:
    twice = node("<ns:group>g</ns:group>")
    with pytest.raises(MetadataRefused, match=r"line 5: the rules name two nodes /g/lamp: .*2"):
        transform(launch(twice, twice), simple)


def test_one_topic_with_two_names() -> None:
    with pytest.raises(MetadataRefused, match=r"line 3: ~a of 'lamp' would get two names"):
        transform(launch(node(topic("a", "~a"), topic("b", "~a"))), simple)


def test_a_name_that_there_is_not() -> None:
    def none(metadata: bytes, queries: Sequence[tuple[NameKind, str]]) -> list[str]:
        raise NameUndefined("no name")

    with pytest.raises(NameUndefined, match="line 2: the node 'lamp': no name"):
        transform(launch(node(topic())), none)


@given(
    st.lists(
        st.tuples(WORDS, WORDS, st.lists(WORDS, unique=True)), max_size=4, unique_by=lambda item: item[0]
    ),
    WORDS,
)
def test_everything_else_is_as_it_was(nodes: list[tuple[str, str, list[str]]], comment: str) -> None:
    """Without metadata and what they became, the two files are the same element by element."""
    inside = [
        node(
            f"<!-- {comment} -->",
            f"<ns:group>{group}</ns:group>",
            '<param name="a" value="b"/>',
            *(topic(each, f"~{each}") for each in topics),
            name=name,
        )
        for name, group, topics in nodes
    ]
    data = launch(*inside)
    after, found = transform(data, simple)
    assert [each.name for each in found] == [f"/{group}/{name}" for name, group, _ in nodes]
    assert after.count(b"<remap ") == sum(len(topics) for *_, topics in nodes)
    assert _rest(after) == _rest(data)
    assert after.count(comment.encode()) >= len(nodes)


def _rest(data: bytes) -> list[tuple[str, dict[str, str]]]:
    return [
        (element.tag, {key: value for key, value in element.items() if key != "ns"})
        for element in ElementTree.fromstring(data).iter()
        if element.tag != "remap" and not element.tag.startswith("{")
    ]
