import time

import pytest

from rossec.inprocess.process import Registrations
from rossec.participant.registrations import GRACE

ME = "/robot"
SUBSCRIBE = ("registerSubscriber", (ME, "/t", "std_msgs/String", "http://me/"))
PROVIDE = ("registerService", (ME, "/s", "rosrpc://me:1", "http://me/"))
NO = [-1, "rossec: no grant", 0]


def recorded(*calls: tuple[str, tuple[object, ...]], answer: object = None) -> Registrations:
    registrations = Registrations(time.time)
    for method, params in calls:
        registrations.record(method, params, [1, "", 0] if answer is None else answer)
    return registrations


def test_a_refused_registration_is_repeated_until_granted() -> None:
    registrations = recorded(SUBSCRIBE, PROVIDE, answer=NO)
    assert registrations.table.refused() == [SUBSCRIBE, PROVIDE]
    registrations.record(*SUBSCRIBE, [1, "", ["http://a/"]])
    assert registrations.table.refused() == [PROVIDE]


def test_an_unregistration_counts_whatever_the_master_answers() -> None:
    registrations = recorded(PROVIDE)
    registrations.record("unregisterService", (ME, "/s", "rosrpc://me:1"), "nonsense")
    assert list(registrations.table) == []


@pytest.mark.parametrize("answer", [[-1, "Error: bad call arity", 0], "nonsense", [1, 2], None])
def test_other_failures_are_not_stored(answer: object) -> None:
    registrations = Registrations(time.time)
    registrations.record(*SUBSCRIBE, answer)
    registrations.record("getParam", (ME, "/x"), [1, "", 5])
    assert list(registrations.table) == []


def test_the_publishers_named_last_count() -> None:
    registrations = recorded(SUBSCRIBE, answer=[1, "", ["http://a/", 7]])
    assert registrations.is_publisher("/t", "http://a/")
    registrations.set_publishers("/t", ["http://b/"])
    assert not registrations.is_publisher("/t", "http://a/")
    registrations.set_publishers("/t", 3)
    assert registrations.is_publisher("/t", "http://b/")
    assert not registrations.is_publisher("/other", "http://b/")


def test_nodes_that_the_master_named_are_stored() -> None:
    """Only the newest: a program that looks up nodes in a loop must not fill the memory."""
    registrations = Registrations(time.time)
    for port in range(1, 1030):
        uri = f"http://h:{port}/"
        registrations.record("lookupNode", ("/robot", "/n"), [1, "node api", uri])
    assert registrations.is_node(("h", 1029))
    assert registrations.is_node(("h", 6))
    assert not registrations.is_node(("h", 5))
    for answer in ([1, "", "no uri"], [-1, "unknown node [/n]", ""], [1, "", 7]):
        registrations.record("lookupNode", ("/robot", "/n"), answer)
    assert registrations.is_node(("h", 6))


def test_a_publisher_counts_while_it_may_be_named_again() -> None:
    now = 0.0
    registrations = Registrations(lambda: now)
    registrations.record(*SUBSCRIBE, [1, "", ["http://a/", 7, "http://b/"]])
    registrations.publishers.session_opened()
    registrations.record(*SUBSCRIBE, [1, "", ["http://b/"]])
    assert [registrations.is_publisher("/t", f"http://{name}/") for name in "abc"] == [True, True, False]
    registrations.set_publishers("/t", [])
    assert not registrations.is_publisher("/t", "http://b/"), "it was removed"
    now += GRACE
    assert not registrations.is_publisher("/t", "http://a/")
