import pytest

from rossec.master.rights import revocation_lists as module
from rossec.master.rights.revocation_lists import SILENT_AFTER, HeldLists
from rossec.master.state.registry import NodeRef

NOW = 1_800_000_000
OLD, NEW = b"o" * 32, b"n" * 32


def node(name: str, key: bytes = b"") -> NodeRef:
    return NodeRef(name, "http://h:1/", key or name.encode())


DOCTOR, HEATING = node("/doctor"), node("/heating")


def test_a_node_holds_what_it_said_last() -> None:
    lists = HeldLists()
    assert not lists.holds(DOCTOR, OLD)
    lists.record(DOCTOR, OLD, NOW)
    assert lists.holds(DOCTOR, OLD)
    lists.record(DOCTOR, NEW, NOW)
    assert lists.holds(DOCTOR, NEW)
    assert not lists.holds(DOCTOR, OLD)
    assert not lists.holds(node("/doctor", b"other key"), NEW)


def test_the_trust_status_counts_each_connected_node() -> None:
    lists = HeldLists()
    lists.record(DOCTOR, NEW, NOW)
    lists.record(HEATING, OLD, NOW)
    assert lists.trust_status([DOCTOR, HEATING], NEW, NOW) == (2, 1, ("/heating",))
    lists.record(HEATING, NEW, NOW)
    assert lists.trust_status([DOCTOR, HEATING, HEATING], NEW, NOW) == (2, 2, ())
    assert lists.trust_status([DOCTOR], NEW, NOW) == (1, 1, ())
    assert lists.trust_status([], NEW, NOW) == (0, 0, ())


def test_a_connected_node_that_says_nothing_does_not_hold_it() -> None:
    lists = HeldLists()
    assert lists.trust_status([DOCTOR], NEW, NOW) == (1, 0, ("/doctor",))
    lists.record(DOCTOR, NEW, NOW)
    assert lists.trust_status([DOCTOR], NEW, NOW + SILENT_AFTER).holding == 1
    assert lists.trust_status([DOCTOR], NEW, NOW + SILENT_AFTER + 1) == (1, 0, ("/doctor",))


def test_anonymous_nodes_count_one_by_one_while_they_speak() -> None:
    lists = HeldLists()
    shared = node("/rviz", b"k")
    lists.record(node("/rviz_1", b"k"), OLD, NOW)  # gone soon
    assert lists.trust_status([shared], NEW, NOW) == (1, 0, ("/rviz_1",))
    later = NOW + SILENT_AFTER + 1
    for name in ("/rviz_2", "/rviz_3"):
        lists.record(node(name, b"k"), NEW, later)
    assert lists.trust_status([shared], NEW, later) == (2, 2, ())


def test_what_is_recorded_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "MAX_HELD_LISTS", 2)
    lists = HeldLists()
    for number in range(5):
        lists.record(node(f"/n{number}", b"k"), NEW, NOW)
        assert lists.trust_status([node("/n", b"k")], NEW, NOW).nodes <= 2
    lists.record(node("/n4", b"k"), OLD, NOW)  # known: nothing is discarded
    assert lists.holds(node("/n4", b"k"), OLD)


def test_other_keys_are_discarded() -> None:
    lists = HeldLists()
    for peer in (DOCTOR, HEATING):
        lists.record(peer, NEW, NOW)
    lists.keep_only(frozenset({DOCTOR.thumbprint}))
    assert lists.holds(DOCTOR, NEW)
    assert not lists.holds(HEATING, NEW)
