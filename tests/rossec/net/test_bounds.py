"""How long messages and units may be, by the type of the messages."""

from rossec.net.limits import BATCH_LIMIT, message_limit, unit_limit
from rossec.ros.tcpros import HEADER_LIMIT


def test_a_type_of_one_size_needs_no_more() -> None:
    assert message_limit(48, 1 << 26) == HEADER_LIMIT, "a malformed one is dropped, not the link"
    assert message_limit(100_000, 1 << 26) == 100_000
    assert message_limit(1 << 30, 1 << 26) == 1 << 26
    assert unit_limit(48, 1 << 26) == HEADER_LIMIT + BATCH_LIMIT


def test_a_type_of_variable_size_gets_the_maximum() -> None:
    assert message_limit(None, 1 << 26) == 1 << 26
    assert unit_limit(None, 1 << 26) == (1 << 26) + BATCH_LIMIT
