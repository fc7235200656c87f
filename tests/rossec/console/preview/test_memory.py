from rossec.console.samples import (
    MAX_MESSAGES,
    MAX_SIZE,
    MAX_TOPIC_SIZE,
    MAX_TOPICS,
    MEMORY_SECONDS,
    PreviewMemory,
    PreviewMessage,
    Recorded,
)

POSE = "geometry_msgs/Pose"


class Clock:
    now = 1_800_000_000.0

    def __call__(self) -> float:
        return self.now


def message(at: float, topic: str = "/pose", kind: str = POSE, data: bytes = b"m") -> PreviewMessage:
    return PreviewMessage(topic, kind, at, data)


def test_the_last_minute_of_a_topic() -> None:
    clock = Clock()
    memory = PreviewMemory(clock)
    assert memory.recorded("/pose") is None
    for passed in (0, 10):
        memory.add(message(clock.now + passed, data=bytes([passed])))
    recorded = memory.recorded("/pose")
    assert recorded == Recorded(
        "/pose", POSE, ((clock.now, b"\0"), (clock.now + 10, b"\x0a")), is_made_up=False
    )
    assert memory.recorded("/other") is None


def test_what_is_older_than_a_minute_is_gone_also_if_nothing_new_comes() -> None:
    clock = Clock()
    memory = PreviewMemory(clock)
    memory.add(message(clock.now))
    memory.add(message(clock.now + 5))
    clock.now += MEMORY_SECONDS
    assert len((memory.recorded("/pose") or Recorded("", "", ())).messages) == 2
    clock.now += 1
    assert len((memory.recorded("/pose") or Recorded("", "", ())).messages) == 1
    clock.now += 5
    memory.drop_old()
    assert memory.recorded("/pose") is None


def test_a_topic_whose_type_changed_begins_anew() -> None:
    clock = Clock()
    memory = PreviewMemory(clock)
    memory.add(message(clock.now))
    memory.add(message(clock.now, kind="std_msgs/String"))
    assert memory.recorded("/pose") == Recorded("/pose", "std_msgs/String", ((clock.now, b"m"),))


def test_a_publisher_does_not_choose_how_much_is_kept() -> None:
    clock = Clock()
    memory = PreviewMemory(clock)
    for number in range(MAX_MESSAGES + 9):
        memory.add(message(clock.now, data=str(number).encode()))
    kept = memory.recorded("/pose")
    assert kept is not None
    assert len(kept.messages) == MAX_MESSAGES
    assert kept.messages[0][1] == b"9"
    for _ in range(20):
        memory.add(message(clock.now, "/image", data=bytes(1024 * 1024)))
    large = memory.recorded("/image")
    assert large is not None
    assert sum(len(data) for _, data in large.messages) <= MAX_TOPIC_SIZE


def test_all_topics_together_are_bounded() -> None:
    clock = Clock()
    memory = PreviewMemory(clock)
    for number in range(MAX_TOPICS + 5):
        for _ in range(3):
            memory.add(message(clock.now, f"/t{number}", data=bytes(1024 * 1024)))
    kept = [memory.recorded(f"/t{number}") for number in range(MAX_TOPICS + 5)]
    found = [each for each in kept if each is not None]
    assert len(found) <= MAX_TOPICS
    assert kept[-1] is None
    assert sum(len(data) for each in found for _, data in each.messages) <= MAX_SIZE
