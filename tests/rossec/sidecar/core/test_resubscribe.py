from rossec.sidecar.core.resubscribe import FIRST_PAUSE, LONGEST_PAUSE, ResubscribeQueue


def always(_: str) -> bool:
    return True


def test_a_lost_topic_is_tried_again_once_after_a_pause() -> None:
    queue = ResubscribeQueue()
    queue.add("/a", 0, 100)
    assert queue.take_due(100, always) == []
    assert queue.take_due(100 + FIRST_PAUSE, always) == ["/a"]
    assert queue.take_due(200, always) == []


def test_without_a_right_it_waits_for_one() -> None:
    queue = ResubscribeQueue()
    queue.add("/a", 0, 100)
    assert queue.take_due(500, lambda topic: topic == "/b") == []
    assert queue.take_due(501, always) == ["/a"]


def test_what_soon_ends_again_is_waited_for_longer() -> None:
    queue = ResubscribeQueue()
    pauses = []
    for _ in range(8):
        queue.add("/a", 0, 1)
        pauses.append(next(at for at in range(100) if queue.take_due(1 + at, always)))
    assert pauses == [1, 2, 4, 8, 16, LONGEST_PAUSE, LONGEST_PAUSE, LONGEST_PAUSE]
    queue.add("/a", 0, LONGEST_PAUSE + 1)
    assert queue.take_due(LONGEST_PAUSE + 1 + FIRST_PAUSE, always) == ["/a"]
