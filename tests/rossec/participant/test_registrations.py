from threading import Event, Thread

from rossec.participant.registrations import RegistrationTable

ME, OWN = "/robot", "http://me/"
SUBSCRIBE = ("registerSubscriber", (ME, "/t", "std_msgs/String", OWN))
PUBLISH = ("registerPublisher", (ME, "/t", "std_msgs/String", OWN))
PROVIDE = ("registerService", (ME, "/s", "rosrpc://me:1", OWN))
PARAMETER = ("subscribeParam", (ME, OWN, "/p"))
ALL = [SUBSCRIBE, PUBLISH, PROVIDE, PARAMETER]
UNDO = [
    ("unregisterSubscriber", (ME, "/t", OWN)),
    ("unregisterPublisher", (ME, "/t", OWN)),
    ("unregisterService", (ME, "/s", "rosrpc://me:1")),
    ("unsubscribeParam", (ME, OWN, "/p")),
]


def recorded(*calls: tuple[str, tuple[object, ...]], refused: bool = False) -> RegistrationTable:
    table = RegistrationTable()
    for method, params in calls:
        table.record(method, params, refused=refused)
    return table


def test_registrations_are_repeated_in_order() -> None:
    table = recorded(*ALL, SUBSCRIBE)
    assert list(table) == ALL
    assert table.refused() == []
    assert table.find("registerService", "/s") == PROVIDE[1]
    assert table.find("registerService", "/t") is None


def test_an_unregistration_removes_the_registration() -> None:
    table = recorded(*ALL)
    for position, (method, params) in enumerate(UNDO, 1):
        table.record(method, params)
        assert list(table) == ALL[position:]
        table.record(method, params)


def test_another_address_keeps_its_registration() -> None:
    """A new program may have the name of one that unregisters late."""
    table = recorded(*ALL)
    for method, params in UNDO:
        table.record(method, tuple(f"{value}/other" if "//" in str(value) else value for value in params))
    assert list(table) == ALL


def test_a_refused_registration_is_kept_until_granted() -> None:
    table = recorded(SUBSCRIBE, PROVIDE, refused=True)
    assert table.refused() == [SUBSCRIBE, PROVIDE]
    table.record(*SUBSCRIBE)
    assert table.refused() == [PROVIDE]
    table.record("unregisterService", UNDO[2][1], refused=True)
    assert table.refused() == []
    assert list(table) == [SUBSCRIBE]


def test_other_calls_and_incomplete_ones_are_ignored() -> None:
    assert list(recorded(("getParam", (ME, "/x")), ("registerService", (ME, "/s")))) == []
    table = recorded(PROVIDE)
    table.record("unregisterService", (ME, "/s"))
    assert list(table) == [PROVIDE]


def test_threads_may_register_while_registrations_are_repeated() -> None:
    table, stop = RegistrationTable(), Event()

    def register() -> None:
        number = 0
        while not stop.is_set():
            number += 1
            table.record("registerService", (ME, f"/s{number % 999}", "", ""), refused=True)
            table.record("unregisterService", (ME, f"/s{number % 777}", ""))

    thread = Thread(target=register)
    thread.start()
    try:
        for _ in range(300):
            assert len(table.refused()) <= len(list(table)) + 999
    finally:
        stop.set()
        thread.join()
