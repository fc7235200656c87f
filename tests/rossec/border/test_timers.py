"""What is due: in the order of its time, and not if it was cancelled."""

from rossec.border.messages import Timers


def test_calls_are_made_when_they_are_due_and_in_order() -> None:
    timers, made = Timers(), list[tuple[str, float]]()
    for name, due in (("late", 3.0), ("early", 1.0), ("middle", 2.0)):
        timers.at(due, lambda now, name=name: made.append((name, now)))  # type: ignore[misc]
    assert timers.next_due == 1.0
    assert len(timers) == 3
    timers.run(0.5)
    assert made == []
    timers.run(2.5)
    assert made == [("early", 2.5), ("middle", 2.5)]
    assert timers.next_due == 3.0
    timers.run(3.0)
    assert len(timers) == 0


def test_what_was_cancelled_is_not_made() -> None:
    timers, made = Timers(), list[float]()
    number = timers.at(1.0, made.append)
    timers.at(2.0, made.append)
    timers.cancel(number)
    timers.cancel(number)
    assert timers.next_due == 2.0
    timers.run(9.0)
    assert made == [9.0]


def test_a_call_may_ask_for_another() -> None:
    timers, made = Timers(), list[float]()

    def again(now: float) -> None:
        made.append(now)
        if len(made) < 3:
            timers.at(now, again)

    timers.at(1.0, again)
    timers.run(1.0)
    assert made == [1.0, 1.0, 1.0]


def test_cancelled_calls_do_not_pile_up() -> None:
    timers = Timers()
    kept = timers.at(10**6, lambda _: None)
    for number in range(10_000):
        timers.cancel(timers.at(number + 100.0, lambda _: None))
    assert len(timers) == 1
    assert len(timers._heap) < 600
    timers.cancel(kept)
    assert timers.next_due is None
