import pytest

from rossec.errors import ConnectionHeaderRefused
from rossec.gateway.rules import TopicSources, TypeChanged, same_type
from rossec.node.subscriber import RawSource
from rossec.participant.definitions import Definition

MD5 = "992ce8a1687cec8c8bd883ec73ca41d1"
STRING = Definition("std_msgs/String", MD5, "string data\n")
OTHER = Definition("std_msgs/Int8", "27ffa0c9c4b8fb8492252bcad9e5c57b", "int8 data\n")


def source(kind: Definition = STRING, *, latching: bool = False) -> RawSource:
    return RawSource("/remote/ada/robot", kind, latching)


def test_the_first_source_says_the_type() -> None:
    sources, one, two = TopicSources(), source(), source()
    assert sources.connect(one)
    assert not sources.connect(two)
    assert sources.type == STRING
    assert len(sources) == 2


def test_a_topic_latches_while_there_is_one_source_that_does() -> None:
    sources, one, two = TopicSources(), source(latching=True), source(latching=True)
    told = [sources.latching]
    for each in (one, two):
        sources.connect(each)
        told.append(sources.latching)
    for each in (one, two):
        sources.disconnect(each)
        told.append(sources.latching)
    sources.connect(source())
    assert [*told, sources.latching] == [False, True, False, True, False, False]


def test_a_source_of_another_type_is_refused_while_one_of_the_type_is_there() -> None:
    sources, one = TopicSources(), source()
    sources.connect(one)
    with pytest.raises(ConnectionHeaderRefused, match="std_msgs/Int8") as caught:
        sources.connect(source(OTHER))
    assert not isinstance(caught.value, TypeChanged)
    sources.disconnect(one)
    with pytest.raises(TypeChanged):
        sources.connect(source(OTHER))
    assert len(sources) == 0


def test_types_are_the_same_when_their_bytes_are() -> None:
    commented = Definition(STRING.name, MD5, "# a text\nstring data\n")
    unreadable = Definition(STRING.name, MD5, "?!")
    assert same_type(STRING, commented)
    assert not same_type(STRING, unreadable)
    assert same_type(unreadable, Definition(STRING.name, MD5, "?!"))
    assert not same_type(STRING, Definition(STRING.name, "0" * 32, STRING.definition))


def test_types_of_one_checksum_and_other_arrays_are_not_the_same() -> None:
    nested = "=" * 80 + "\nMSG: a/V\nfloat64 x\n"
    one = Definition("a/T", "", f"V[0] v\n{nested}")
    two = Definition("a/T", "", f"V v\n{nested}")
    from grants.filters import layout

    md5 = layout.parse("a/T", one.definition).md5
    assert md5 == layout.parse("a/T", two.definition).md5
    assert not same_type(Definition("a/T", md5, one.definition), Definition("a/T", md5, two.definition))
