"""The publishers of a topic at the beginning of a slot, by what was noted."""

from hypothesis import given
from hypothesis import strategies as st

from grants.limits import MAX_SLOT
from rossec.master.state.graph import MAX_ENDED, MAX_TOPICS, PublisherLog
from rossec.master.state.registry import Kind, NodeRef, Registry

NODE = NodeRef("/a", "http://a:1/", b"a")
TYPE = "std_msgs/Bool"


class Noted:
    def __init__(self) -> None:
        self.registry = Registry()
        self.log = PublisherLog(self.registry)

    def publish(self, now: int, topic: str = "/t") -> None:
        self.log.now = now
        self.registry.register_publisher(topic, TYPE, NODE)
        self.log.note(topic)

    def end(self, now: int, topic: str = "/t", *, cut: bool = False) -> None:
        self.log.now = now
        self.registry.unregister(Kind.PUBLISHER, topic, NODE)
        self.log.note(topic, lambda _: cut)

    def told(self, now: int, slot: int = 60, topic: str = "/t") -> bool:
        self.log.now = now
        return bool(self.log.at(topic, slot))


@given(st.integers(10, 90), st.lists(st.integers(0, 400), min_size=1, max_size=6, unique=True))
def test_what_is_told_is_what_was_at_the_beginning(slot: int, moments: list[int]) -> None:
    """Of changes in alternation; in the second of the beginning it is the one before it."""
    noted, changes = Noted(), sorted(moments)
    for now in range(500):
        if now in changes:
            (noted.end if changes.index(now) % 2 else noted.publish)(now)
        begin = now - now % slot
        before = sum(change < begin for change in changes)
        assert noted.told(now, slot) == bool(before % 2)


def test_what_had_to_go_is_told_no_longer() -> None:
    noted = Noted()
    noted.publish(10)
    assert noted.told(70)
    noted.end(71, cut=True)
    assert not noted.told(71)
    assert len(noted.log) == 0


def test_what_nobody_noted_is_noted_by_a_look() -> None:
    noted = Noted()
    noted.registry.register_publisher("/t", TYPE, NODE)
    assert not noted.told(10)
    assert noted.told(60)
    assert noted.log.at("/t", 60)[0].type == TYPE


def test_what_ended_is_bounded_and_forgotten() -> None:
    noted = Noted()
    for number in range(2 * MAX_ENDED):
        noted.publish(100 * number)
        noted.end(100 * number + 50)
    assert len(noted.log) == MAX_ENDED
    assert [*noted.log.ended_topics("/a")] == ["/t"] == noted.log.topics()
    assert [*noted.log.ended_topics("/b")] == []
    later = 100_000 + MAX_SLOT
    noted.publish(later)
    noted.end(later + 1)
    assert len(noted.log) == 1
    for number in range(MAX_TOPICS + 5):
        noted.publish(later, f"/t{number}")
        noted.end(later + 1, f"/t{number}")
    assert len(noted.log) == MAX_TOPICS
