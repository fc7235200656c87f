"""How much one thing, and whoever is not authenticated yet, may ask."""

import pytest

from rossec.border import conversations
from rossec.border.conversations import (
    MESSAGE_BURST,
    MESSAGE_RATE,
    SOURCE_BURST,
    Quota,
    Unauthenticated,
    network_of,
)

NOW = 1000.0


def allowed(taken: list[bool]) -> int:
    return sum(taken)


def test_a_thing_has_its_burst_and_then_its_rate() -> None:
    quota = Quota()
    assert allowed([quota.take(NOW) for _ in range(100)]) == MESSAGE_BURST
    assert quota.dropped == 100 - MESSAGE_BURST
    assert allowed([quota.take(NOW + 1) for _ in range(100)]) == MESSAGE_RATE
    assert allowed([quota.take(NOW + 99) for _ in range(100)]) == MESSAGE_BURST


def test_one_sender_does_not_take_what_others_have() -> None:
    budget = Unauthenticated(50)
    assert allowed([budget.take("10.0.0.1", 1, NOW) for _ in range(100)]) == SOURCE_BURST
    assert budget.take("10.0.0.2", 1, NOW)


@pytest.mark.parametrize("host", ["10.0.0.{}", "2001:db8::{}:1", "fe80::{}%eth0"])
def test_one_host_with_many_ports_leaves_half_to_others(host: str) -> None:
    budget = Unauthenticated(50)
    same = [host.format(1 if "." in host else number % 9 + 1) for number in range(1000)]
    assert allowed([budget.take(each, port, NOW) for port, each in enumerate(same)]) == 25
    others = [budget.take(f"10.1.{number}.1", 1, NOW) for number in range(100)]
    assert allowed(others) == 25


def test_all_senders_together_are_bounded() -> None:
    budget = Unauthenticated(50)
    for later in (0, 1):
        taken = [budget.take(f"10.{later}.{number}.1", 1, NOW + later) for number in range(256)]
        assert allowed(taken) == 50


def test_the_part_of_an_address_that_a_host_cannot_change() -> None:
    assert network_of("10.0.0.1") == network_of("::ffff:10.0.0.1")
    assert network_of("2001:db8::1") == network_of("2001:db8::ffff:1")
    assert network_of("2001:db8::1") != network_of("2001:db8:0:1::1")


def test_a_bounded_number_of_senders_is_remembered() -> None:
    budget = Unauthenticated(10**9)
    for number in range(conversations.MAX_SOURCES + 10):
        assert budget.take(f"10.{number // 256}.{number % 256}.1", 1, NOW)
    assert len(budget._sources) == conversations.MAX_SOURCES
