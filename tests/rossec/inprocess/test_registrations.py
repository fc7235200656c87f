import threading
import time

import pytest

from rossec.inprocess.registrations import Registrations
from rossec.participant.publisher_grace import GRACE

ME = "/robot"
SUBSCRIBE = ("registerSubscriber", (ME, "/t", "std_msgs/String", "http://me/"))
PROVIDE = ("registerService", (ME, "/s", "rosrpc://me:1", "http://me/"))
PARAMETER = ("subscribeParam", (ME, "http://me/", "/p"))
NO = [-1, "rossec: no grant", 0]


def noted(*calls: tuple[str, tuple[object, ...]], answer: object = None) -> Registrations:
    registrations = Registrations(ME, time.time)
    for method, params in calls:
        registrations.note(method, params, [1, "", 0] if answer is None else answer)
    return registrations


def test_what_was_registered_is_registered_again_in_order() -> None:
    registrations = noted(SUBSCRIBE, PROVIDE, PARAMETER, SUBSCRIBE)
    assert registrations.all() == [SUBSCRIBE, PROVIDE, PARAMETER]
    assert registrations.refused() == []


def test_what_was_taken_back_is_forgotten() -> None:
    registrations = noted(SUBSCRIBE, PROVIDE, PARAMETER)
    registrations.note("unregisterSubscriber", (ME, "/t", "http://me/"), [1, "", 1])
    registrations.note("unregisterService", (ME, "/s", "rosrpc://me:1"), [1, "", 1])
    registrations.note("unsubscribeParam", (ME, "http://me/", "/p"), [1, "", 1])
    assert registrations.all() == []


def test_what_was_refused_is_tried_again_until_it_is_granted() -> None:
    registrations = noted(SUBSCRIBE, PROVIDE, answer=NO)
    assert registrations.refused() == [SUBSCRIBE, PROVIDE]
    registrations.note(*SUBSCRIBE, [1, "", ["http://a/"]])
    assert registrations.refused() == [PROVIDE]
    registrations.note("unregisterService", (ME, "/s", "rosrpc://me:1"), [1, "", 0])
    assert registrations.refused() == []


@pytest.mark.parametrize("answer", [[-1, "Error: bad call arity", 0], "nonsense", [1, 2], None])
def test_other_failures_are_not_kept(answer: object) -> None:
    registrations = Registrations(ME, time.time)
    registrations.note(*SUBSCRIBE, answer)
    registrations.note("getParam", (ME, "/x"), [1, "", 5])
    assert registrations.all() == []


def test_the_publishers_are_those_named_last() -> None:
    registrations = noted(SUBSCRIBE, answer=[1, "", ["http://a/", 7]])
    assert registrations.is_publisher("/t", "http://a/")
    registrations.publishers_are("/t", ["http://b/"])
    assert not registrations.is_publisher("/t", "http://a/")
    registrations.publishers_are("/t", 3)
    assert registrations.is_publisher("/t", "http://b/")
    assert not registrations.is_publisher("/other", "http://b/")


@pytest.mark.parametrize(
    ("method", "params", "own"),
    [
        ("registerPublisher", (ME, "/rosout", "x", "y"), True),
        ("registerPublisher", (ME, "/scan", "x", "y"), False),
        ("registerService", (ME, "/robot/get_loggers", "x", "y"), True),
        ("registerService", (ME, "/other/get_loggers", "x", "y"), False),
        ("getParam", (ME, "/use_sim_time"), True),
        ("getParam", (ME, "/secret"), False),
        ("subscribeParam", (ME, "x", "/rosout_disable_topics_generation"), True),
        ("setParam", (ME, "/use_sim_time", True), False),
    ],
)
def test_what_rospy_asks_for_by_itself_is_known(
    method: str, params: tuple[object, ...], own: bool
) -> None:
    assert Registrations(ME, time.time).is_rospys_own(method, params) is own


def test_threads_may_register_while_everything_is_registered_again() -> None:
    registrations = Registrations(ME, time.time)
    going = threading.Event()

    def register() -> None:
        number = 0
        while not going.is_set():
            number += 1
            registrations.note("registerService", (ME, f"/s{number % 999}", "", ""), NO)
            registrations.note("unregisterService", (ME, f"/s{number % 777}"), [1, "", 1])

    thread = threading.Thread(target=register)
    thread.start()
    try:
        for _ in range(300):
            assert len(registrations.refused()) <= len(registrations.all()) + 999
    finally:
        going.set()
        thread.join()


def test_nodes_that_the_master_has_named_are_known() -> None:
    """The newest of them: a program that looks for ever must not fill the memory."""
    registrations = Registrations("/robot", time.time)
    for port in range(1, 1030):
        uri = f"http://h:{port}/"
        registrations.note("lookupNode", ("/robot", "/n"), [1, "node api", uri])
    assert registrations.is_node(("h", 1029))
    assert registrations.is_node(("h", 6))
    assert not registrations.is_node(("h", 5))
    for answer in ([1, "", "no uri"], [-1, "unknown node [/n]", ""], [1, "", 7]):
        registrations.note("lookupNode", ("/robot", "/n"), answer)
    assert registrations.is_node(("h", 6))


def test_a_publisher_is_one_while_it_may_yet_be_named_again() -> None:
    now = 0.0
    registrations = Registrations(ME, lambda: now)
    registrations.note(*SUBSCRIBE, [1, "", ["http://a/", 7, "http://b/"]])
    registrations.session_opened()
    registrations.note(*SUBSCRIBE, [1, "", ["http://b/"]])
    assert [registrations.is_publisher("/t", f"http://{name}/") for name in "abc"] == [
        True, True, False,
    ]  # fmt: skip
    registrations.publishers_are("/t", [])
    assert not registrations.is_publisher("/t", "http://b/"), "it was taken away"
    now += GRACE
    assert not registrations.is_publisher("/t", "http://a/")
