"""One line for each cause and peer in a minute."""

import logging
import threading

import pytest

from rossec.errors import MessageError, WireError
from rossec.participant import delivery_options

LOG = logging.getLogger("rossec.node")


@pytest.fixture
def now(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """The time of records, which the test sets."""
    time = [1000.0]
    make = LOG.makeRecord

    def made(*arguments: object) -> logging.LogRecord:
        record = make(*arguments)  # type: ignore[arg-type]  # as they were given
        record.created = time[0]
        return record

    monkeypatch.setattr(LOG, "makeRecord", made)
    return time


def warn(cause: object, peer: str = "/eve", where: str = "/order") -> None:
    delivery_options.warn(LOG, delivery_options.RECEIVED, where, peer, cause)


def test_a_cause_is_logged_once_in_a_minute(now: list[float], caplog: pytest.LogCaptureFixture) -> None:
    for number in range(1000):
        warn(MessageError(f"a text of its choice: {number}"))
    assert caplog.messages == ["/order: withheld a message of /eve: a text of its choice: 0"]
    now[0] += 60
    warn(MessageError("again"))
    warn(MessageError("and again"))
    assert caplog.messages[1:] == [
        "/order: withheld a message of /eve: again (999 more like this since it was logged last)"
    ]
    assert {record.name for record in caplog.records} == {"rossec.node"}


def test_other_causes_peers_and_places_are_logged(now: list[float], caplog: pytest.LogCaptureFixture) -> None:
    for _ in range(3):
        warn(MessageError("one"))
        warn(WireError("two"))
        warn(MessageError("three"), peer="/viewer")
        warn(MessageError("four"), where="/map")
        warn("five")
    assert [text.rpartition(": ")[2] for text in caplog.messages] == ["one", "two", "three", "four", "five"]


def test_a_line_about_what_is_not_reached_has_the_hint(caplog: pytest.LogCaptureFixture) -> None:
    for peer, cause in (("a", MessageError("no", "100 % sure?")), ("b", MessageError("no"))):
        delivery_options.warn(LOG, delivery_options.UNREACHED, "/map", peer, cause)
    assert caplog.messages == ["/map: not connected to a: no (100 % sure?)", "/map: not connected to b: no"]


def test_threads(now: list[float], caplog: pytest.LogCaptureFixture) -> None:
    threads = [threading.Thread(target=warn, args=("one",)) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(caplog.messages) == 1


def test_nothing_is_counted_below_the_log_level(now: list[float], caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.ERROR, "rossec.node"):
        warn("one")
    warn("one")
    assert len(caplog.messages) == 1
