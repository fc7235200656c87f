"""Which addresses are a node's own."""

import pytest

from rossec.errors import ConnectionHeaderRefused
from rossec.participant.connections import OwnAddresses


@pytest.fixture
def own() -> OwnAddresses:
    own = OwnAddresses()
    own.add_ports("Robot.local", 4000)
    own.add_ports("Robot.local", 4001)
    return own


def test_own_addresses_are_recognized(own: OwnAddresses) -> None:
    assert own.is_own(("robot.LOCAL", 4001))
    assert own.is_own(("robot.local", 4000))
    for other in ("robot.local", 4002), ("other", 4000), ("", 4000):
        assert not own.is_own(other)


def test_no_address_is_own_without_a_port() -> None:
    assert not OwnAddresses().is_own(("", 0))


def test_an_ipv6_address_is_own_with_and_without_brackets() -> None:
    own = OwnAddresses()
    own.add_ports("[fd00::A]", 4000)
    assert own.is_own(("fd00::a", 4000))


def test_a_redirect_from_another_node_to_itself_is_refused(own: OwnAddresses) -> None:
    own.check_redirect(("other", 1), ("other", 2))
    own.check_redirect(("robot.local", 4000), ("robot.local", 4001))
    own.check_redirect(("robot.local", 4000), ("other", 1))
    with pytest.raises(ConnectionHeaderRefused, match="at other port 1 sends this node to itself"):
        own.check_redirect(("other", 1), ("robot.local", 4001))
