"""What a policy says of its own types and of bare values."""

import pytest

from grants.filters.layout import Layout, parse
from grants.policy.model import SAYABLE, Vocabulary, read_rooms, read_vocabulary
from grants.policy.source import Mistakes, YamlMapping, YamlScalar, read_source
from grants.vocabulary.contents import Content, DataWord
from tests.grants.policy.policies import definition

TYPES = {"/door": "std_msgs/Bool", "/bed": "acme_msgs/Bed", "/rooms/*/lamp": "std_msgs/Bool"}
BED = parse("acme_msgs/Bed", "string who\nfloat64 weight\nint32[3] at")


def layout_of(name: str, position: YamlScalar) -> Layout | None:
    if name == "acme_msgs/Bed":
        return BED
    return None if name.startswith("other") else parse(name, definition(name))


def read(text: str) -> tuple[Vocabulary, list[str]]:
    mistakes = Mistakes("p.yaml")
    part = read_source(text, mistakes)
    assert isinstance(part, YamlMapping)
    found = read_vocabulary(part, None, TYPES, layout_of)
    return found, [f"{item.message}|{item.hint}" for item in mistakes.found]


def test_a_type_says_words_and_contents() -> None:
    found, mistakes = read("acme_msgs/Bed: {who: name, weight: home, at: position}")
    assert mistakes == []
    described = found.describe(BED)
    assert [field.content for field in described.fields] == [
        Content.NAME,
        Content.READING,
        Content.UNCERTAINTY,
    ]
    assert described.words == (DataWord.POSITION, DataWord.IDENTITY, DataWord.HOME)


def test_a_topic_says_what_its_value_is() -> None:
    found, mistakes = read('/door: {data: home}\n"/rooms/*/lamp": {data: presence}')
    assert mistakes == []
    layout = parse("std_msgs/Bool", definition("std_msgs/Bool"))
    assert found.describe(layout, "/door").words == (DataWord.HOME,)
    assert found.describe(layout, "/rooms/a/lamp").unknown == ()
    assert found.describe(layout, "/rooms/*/lamp").unknown == ()
    assert found.describe(layout, "/window").unknown == ("data",)
    assert found.describe(layout).unknown == ("data",)


@pytest.mark.parametrize(
    ("text", "message", "hint"),
    [
        ("acme_msgs/Bed: {whom: name}", "no field 'whom' in acme_msgs/Bed", "'who'"),
        ("acme_msgs/Bed: {who: nam}", "unknown word or content: 'nam'", "'name'"),
        ("acme_msgs/Bed: {who: bare}", "unknown word or content: 'bare'", ""),
        ("acme_msgs/Bed: 7", "vocabulary of acme_msgs/Bed must be a mapping", ""),
        ("/doors: {data: home}", "the message type of /doors is unknown", "'/door'"),
        ("bed: {who: name}", "not a type or a topic: 'bed'", "package/Type, or /topic"),
        (
            "sensor_msgs/Temperature: {temperature: format}",
            "temperature of sensor_msgs/Temperature is in the standard vocabulary",
            "it is: ambient-temperature",
        ),
        (
            "geometry_msgs/PoseStamped: {pose: home}",
            "pose of geometry_msgs/PoseStamped is in the standard vocabulary",
            "it is: coordinate",
        ),
    ],
)
def test_mistakes_are_named(text: str, message: str, hint: str) -> None:
    _, mistakes = read(text)
    assert len(mistakes) == 1
    assert mistakes[0].startswith(message)
    assert hint in mistakes[0]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('kitchen: "0 0"', "kitchen"),
        ("kitchen: [1]", "kitchen must be text"),
        ('hysteresis: "0 0, 4 3"', "no room can be called hysteresis"),
        ('kitchen: "0 0, 0.5 0.5"', "a room has less than 1 square metre"),
    ],
)
def test_a_plan_that_is_none_is_a_mistake(text: str, message: str) -> None:
    mistakes = Mistakes("p.yaml")
    assert read_rooms(read_source(text, mistakes)) is None
    assert message in mistakes.found[0].message


def test_an_unknown_type_is_left_to_its_reader() -> None:
    assert read("other_msgs/Thing: {a: home}") == (Vocabulary(), [])


def test_a_word_alone_is_shown_in_no_part() -> None:
    """Metres or millimetres: only a content says the unit, so a word is hidden."""
    assert SAYABLE["position"] is not Content.COORDINATE
    assert {SAYABLE[word] for word in DataWord}.isdisjoint({Content.COORDINATE, Content.NAME})
    assert "picture" not in SAYABLE


LAMPS = {
    "/a/x": "std_msgs/Float64",
    "/*/x": "std_msgs/Float64",
    "/a/*": "std_msgs/Float64",
    "/b/x": "std_msgs/Float64",
}
VALUE = parse("std_msgs/Float64", definition("std_msgs/Float64"))


def contents(topic: str, *said: str) -> list[Content]:
    part = read_source("\n".join(said), mistakes := Mistakes("p.yaml"))
    found = read_vocabulary(part, None, LAMPS, layout_of)
    assert mistakes.found == []
    return [field.content for field in found.describe(VALUE, topic).fields]


@pytest.mark.parametrize("turn", [1, -1])
def test_the_narrowest_topic_says_what_a_value_is(turn: int) -> None:
    """It was the last in the file: what is said of one topic was undone by a pattern."""
    said = ["/a/x: {data: coordinate}", '"/*/x": {data: temperature}'][::turn]
    assert contents("/a/x", *said) == [Content.COORDINATE]
    assert contents("/b/x", *said) == [Content.TEMPERATURE]
    assert contents("/*/x", *said) == [Content.UNKNOWN]


@pytest.mark.parametrize("turn", [1, -1])
def test_two_patterns_that_contradict_each_other_say_nothing(turn: int) -> None:
    said = ['"/a/*": {data: coordinate}', '"/*/x": {data: temperature}'][::turn]
    assert contents("/a/x", *said) == [Content.UNKNOWN]
    assert contents("/b/x", *said) == [Content.TEMPERATURE]
    assert contents("/a/x", *said, "/a/x: {data: charge}") == [Content.CHARGE]
    same = ['"/a/*": {data: charge}', '"/*/x": {data: charge}'][::turn]
    assert contents("/a/x", *same) == [Content.CHARGE]
