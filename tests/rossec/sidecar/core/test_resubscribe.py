from rossec.sidecar.core.master_calls import FIRST_DELAY, MAX_DELAY, ResubscribeQueue


def always(_: str) -> bool:
    return True


def test_a_topic_is_due_once_after_a_delay() -> None:
    queue = ResubscribeQueue()
    queue.add("/a", 0, 100)
    assert queue.take_due(100, always) == []
    assert queue.take_due(100 + FIRST_DELAY, always) == ["/a"]
    assert queue.take_due(200, always) == []


def test_a_topic_without_a_grant_waits_for_one() -> None:
    queue = ResubscribeQueue()
    queue.add("/a", 0, 100)
    assert queue.take_due(500, lambda topic: topic == "/b") == []
    assert queue.take_due(501, always) == ["/a"]


def test_the_delay_doubles_while_connections_end_soon() -> None:
    queue = ResubscribeQueue()
    delays = []
    for _ in range(8):
        queue.add("/a", 0, 1)
        delays.append(next(at for at in range(100) if queue.take_due(1 + at, always)))
    assert delays == [1, 2, 4, 8, 16, MAX_DELAY, MAX_DELAY, MAX_DELAY]
    queue.add("/a", 0, MAX_DELAY + 1)
    assert queue.take_due(MAX_DELAY + 1 + FIRST_DELAY, always) == ["/a"]
