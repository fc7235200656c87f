import threading

import pytest

from rossec.inprocess.registrations import Registrations

ME = "/robot"
SUBSCRIBE = ("registerSubscriber", (ME, "/t", "std_msgs/String", "http://me/"))
PROVIDE = ("registerService", (ME, "/s", "rosrpc://me:1", "http://me/"))
PARAMETER = ("subscribeParam", (ME, "http://me/", "/p"))
NO = [-1, "rossec: no grant", 0]


def noted(*calls: tuple[str, tuple[object, ...]], answer: object = None) -> Registrations:
    registrations = Registrations(ME)
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
    registrations = Registrations(ME)
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
    assert Registrations(ME).is_rospys_own(method, params) is own


def test_threads_may_register_while_everything_is_registered_again() -> None:
    registrations = Registrations(ME)
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
