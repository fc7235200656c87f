"""What a border router knows of each thing: one conversation, bounded, found by name and by kid."""

import pytest

from rossec.border import conversations
from rossec.border.conversations import REMEMBERED, Conversation, Conversations
from rossec.border.messages import OscoreContext

HERE, THERE = ("::1", 5683, 0, 0), ("::1", 5684, 0, 0)


def conversation(name: str, kid: bytes) -> Conversation:
    return Conversation(name, OscoreContext(bytes(16), b"", b"", kid), HERE)


@pytest.fixture
def ended() -> list[str]:
    return []


@pytest.fixture
def held(ended: list[str]) -> Conversations:
    return Conversations(lambda each: ended.append(each.name))


def test_a_thing_has_one(held: Conversations, ended: list[str]) -> None:
    first, second = conversation("/lamp", b"1"), conversation("/lamp", b"2")
    held.add(first)
    assert (held.of("/lamp"), held.find(b"1"), held.find(b"2")) == (first, first, None)
    held.add(second)
    assert (held.of("/lamp"), held.find(b"1"), held.find(b"2")) == (second, None, second)
    assert (ended, len(held), held.all()) == (["/lamp"], 1, [second])
    held.drop("/lamp")
    held.drop("/lamp")
    assert (ended, len(held), held.find(b"2")) == (["/lamp", "/lamp"], 0, None)


def test_a_thing_with_a_secret_that_was_renamed(held: Conversations, ended: list[str]) -> None:
    """It has its kid under either name."""
    former, now = conversation("/things/fan", b"k"), conversation("/kitchen/fan", b"k")
    held.add(former)
    held.add(now)
    assert ended == ["/things/fan"]
    assert held.find(b"k") is now
    held.drop("/things/fan")
    assert held.find(b"k") is now
    held.drop("/kitchen/fan")
    assert held.find(b"k") is None


def test_the_one_that_was_quiet_for_longest_makes_room(
    held: Conversations, ended: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(conversations, "CAPACITY", 2)
    a, b = conversation("/a", b"a"), conversation("/b", b"b")
    held.add(a)
    held.add(b)
    held.used(a, HERE)
    held.add(conversation("/c", b"c"))
    assert ended == ["/b"]
    assert [each.name for each in held.all()] == ["/a", "/c"]
    held.add(conversation("/a", b"d"))
    assert ended == ["/b", "/a"]


def test_answers_are_kept_for_repeated_requests() -> None:
    thing = conversation("/lamp", b"k")
    assert thing.kid == b"k"
    assert thing.remembered(HERE, 1) is None
    for number in range(REMEMBERED + 1):
        thing.remember(HERE, number, b"%d" % number)
    assert thing.remembered(HERE, 0) is None
    assert thing.remembered(HERE, REMEMBERED) == b"%d" % REMEMBERED
    assert thing.remembered(THERE, REMEMBERED) is None


def test_where_things_are(held: Conversations) -> None:
    there = ("::2", 5683)
    a, b = conversation("/a", b"a"), conversation("/b", b"b")
    held.add(a)
    held.add(b)
    held.used(a, there)
    assert held.at(HERE) is b
    assert held.at(there) is a
    held.drop("/b")
    assert held.at(HERE) is None
    held.used(a, there)
    held.drop("/a")
    assert held.at(there) is None


def test_where_two_were_is_the_latest() -> None:
    held = Conversations(lambda _: None)
    a, b = conversation("/a", b"a"), conversation("/b", b"b")
    held.add(a)
    held.add(b)
    held.drop("/a")
    assert held.at(HERE) is b


def test_message_ids_count_from_a_number_that_is_given() -> None:
    made = Conversation("/a", OscoreContext(bytes(16), b"", b"", b"a"), HERE, 0xFFFE)
    assert [made.new_mid() for _ in range(3)] == [0xFFFF, 0, 1]
