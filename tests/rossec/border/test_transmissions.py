"""Confirmable messages: sent again with longer pauses, until they are acknowledged (RFC 7252)."""

import pytest

from rossec.border.messages import ACK_TIMEOUT, MAX_RETRANSMIT, Address, Timers, Transmissions

THING: Address = ("::1", 5683, 0, 0)


class Line:
    """What was sent, and what failed."""

    def __init__(self, rand: float = 0.0) -> None:
        self.sent: list[tuple[bytes, Address]] = []
        self.failed = 0
        self.timers = Timers()
        self.open = Transmissions(
            lambda data, address: self.sent.append((data, address)), self.timers, lambda: rand
        )

    def send(self, mid: int = 7, now: float = 0.0) -> None:
        self.open.send(b"hello", mid, THING, now, self._fail)

    def _fail(self) -> None:
        self.failed += 1


@pytest.mark.parametrize(("rand", "first"), [(0.0, ACK_TIMEOUT), (0.5, ACK_TIMEOUT * 1.25)])
def test_it_is_sent_again_with_pauses_that_double(rand: float, first: float) -> None:
    line = Line(rand)
    line.send()
    due, pauses = 0.0, []
    while line.timers.next_due is not None:
        pauses.append(line.timers.next_due - due)
        due = line.timers.next_due
        line.timers.run(due)
    assert pauses == [first * 2**number for number in range(MAX_RETRANSMIT + 1)]
    assert line.sent == [(b"hello", THING)] * (1 + MAX_RETRANSMIT)
    assert (line.failed, len(line.open)) == (1, 0)


def test_an_acknowledged_message_is_not_sent_again() -> None:
    line = Line()
    line.send()
    line.open.acknowledge(THING, 8)
    line.open.acknowledge(("::2", 5683, 0, 0), 7)
    assert len(line.open) == 1
    line.open.acknowledge(THING, 7)
    line.open.acknowledge(THING, 7)
    line.timers.run(1000.0)
    assert (len(line.sent), line.failed, len(line.open)) == (1, 0, 0)


def test_a_message_replaces_another_with_its_id() -> None:
    line = Line(0.999)
    line.send(9)
    line.send(9)
    assert len(line.open) == 1
