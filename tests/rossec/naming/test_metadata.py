"""Metadata of a node, as they are read and refused."""

import pytest

from rossec.errors import MetadataRefused
from rossec.naming import rule_runner
from rossec.naming.requests import MAX_ENTRIES, Entry, Metadata, NameKind, check_query, read


def test_the_metadata_of_the_thesis_are_read() -> None:
    assert read(rule_runner.shipped_example("phone.xml")) == Metadata(
        "schneider",
        "htc_desire",
        "smartphones",
        (
            Entry(NameKind.TOPIC, "accelerometer", "sensor", None, mobile=True),
            Entry(NameKind.TOPIC, "temperature", "sensor", "building1/room3"),
        ),
    )


def test_the_lines_of_topics_and_services_are_known() -> None:
    text = b"<node>\n<x><topic/></x>\n<topic>\n<name>a</name></topic>\n<service><name>b</name>"
    assert [entry.line for entry in read(text + b"</service></node>").entries] == [3, 5]


def test_everything_may_be_missing_and_others_may_stand_beside() -> None:
    assert read(b"<node/>") == Metadata()
    text = b"<node><room>3</room><name> a </name><owner/><service><name>b</name><x/></service></node>"
    assert read(text) == Metadata(None, "a", None, (Entry(NameKind.SERVICE, "b"),))


def test_a_name_can_be_asked_for_the_node_and_everything_it_has() -> None:
    assert list(read(rule_runner.shipped_example("phone.xml")).queries()) == [
        (NameKind.NODE, ""),
        (NameKind.TOPIC, "accelerometer"),
        (NameKind.TOPIC, "temperature"),
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot/>", "metadata are a <node>, not <robot>"),
        ("<node>", "line 1: metadata that are no XML: no element found"),
        ("<node>\n</nod>", "line 2: metadata that are no XML: mismatched tag"),
        ("<node/><node/>", "line 1: metadata that are no XML: junk after"),
        ("<node>&nbsp;</node>", "metadata that"),
        ("<!DOCTYPE node><node/>", "line 1: metadata with a document type"),
        ("<node><name>a</name><name>b</name></node>", "<node> has 2 times <name>"),
        ("<node><name><b/>a</name></node>", "<name> has other elements inside"),
        ("<node><topic/></node>", "line 1: a topic without <name>"),
        ("<node><topic><name>a\nb</name></topic></node>", "'a\\nb' is no name of a topic"),
        ("<node><topic><name>" + "a" * 256 + "</name></topic></node>", "is no name of a topic"),
        (
            "<node><topic><name>a</name><mobile>>true</mobile></topic></node>",
            "line 1: <mobile> is true or false, not '>true'",
        ),
        ("<node>" + 2 * "<topic><name>a</name></topic>" + "</node>", "two topics with the name 'a'"),
    ],
)
def test_what_is_not_metadata_is_refused(text: str, message: str) -> None:
    with pytest.raises(MetadataRefused) as caught:
        read(text.encode())
    assert message in str(caught.value)


def test_a_topic_and_a_service_may_have_the_same_name() -> None:
    text = b"<node><topic><name>a</name></topic><service><name>a</name></service></node>"
    assert [entry.kind for entry in read(text).entries] == [NameKind.TOPIC, NameKind.SERVICE]


def test_the_number_of_entries_is_limited() -> None:
    entries = "".join(f"<topic><name>t{i}</name></topic>" for i in range(MAX_ENTRIES + 1))
    with pytest.raises(MetadataRefused, match="257 topics and services where 256"):
        read(f"<node>{entries}</node>".encode())


def test_latin_letters_are_read_by_their_encoding() -> None:
    text = b'<?xml version="1.0" encoding="ISO-8859-1"?><node><owner>M\xfcller</owner></node>'
    assert read(text).owner == "Müller"


def test_a_node_is_asked_for_without_a_name_and_others_with_one() -> None:
    assert check_query(NameKind.NODE, "") == (NameKind.NODE, "")
    assert check_query(NameKind.TOPIC, "a b") == (NameKind.TOPIC, "a b")
    for kind, which in ((NameKind.NODE, "a"), (NameKind.TOPIC, ""), (NameKind.SERVICE, "")):
        with pytest.raises(MetadataRefused, match="asked for by its name"):
            check_query(kind, which)
