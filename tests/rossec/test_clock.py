"""The clock of a process, against a host's that is set, and a machine that sleeps."""

import re
import time
from pathlib import Path

import pytest

import rossec
from ca.revocation.trust_status import SKEW
from rossec import clock
from rossec.clock import DRIFT, Clock, Setbacks, counter

BEGIN = 1_000_000.0


class Host:
    """A host whose clock is set."""

    def __init__(self) -> None:
        self.shows = BEGIN
        self.up = 100.0
        self.clock = Clock(lambda: self.shows, lambda: self.up)

    def passes(self, seconds: float) -> float:
        self.shows += seconds
        self.up += seconds
        return self.clock.time()


@pytest.fixture
def host() -> Host:
    return Host()


def test_the_time_is_the_hosts(host: Host) -> None:
    assert host.clock.time() == BEGIN
    assert host.passes(60) == BEGIN + 60
    host.shows += 3600  # set ahead
    assert host.passes(1) == BEGIN + 3661
    assert host.clock.setbacks == 0


def test_a_clock_set_back_keeps_running_forward(host: Host) -> None:
    host.passes(60)
    host.shows -= 3600
    assert host.clock.time() == BEGIN + 60
    assert host.clock.setbacks == 1
    assert host.passes(1000) == pytest.approx(BEGIN + 1060 - 1000 * DRIFT)
    assert host.clock.setbacks == 1, "each is reported once"
    host.shows -= 10
    host.clock.time()
    assert host.clock.setbacks == 2


def test_many_small_steps_back_are_a_large_one(host: Host) -> None:
    for _ in range(3):
        host.shows -= 2
        assert host.clock.time() == BEGIN
    assert host.clock.setbacks == 1


def test_a_small_step_back_is_caught_up(host: Host) -> None:
    host.shows -= SKEW
    assert host.clock.time() == BEGIN
    assert host.passes(SKEW / DRIFT) == pytest.approx(host.shows)
    assert host.passes(1) == host.shows
    assert host.clock.setbacks == 0


def test_a_clock_that_is_put_right_counts_again(host: Host) -> None:
    host.shows -= 3600
    host.clock.time()
    host.shows += 3600
    assert host.passes(7) == BEGIN + 7
    host.shows -= 3600
    host.clock.time()
    assert host.clock.setbacks == 2


def test_time_in_suspend_counts(host: Host) -> None:
    """The host's clock does not go on while it sleeps, or is set back in its sleep."""
    host.up += 3600
    assert host.clock.time() == pytest.approx(BEGIN + 3600 - 3600 * DRIFT)
    assert host.clock.setbacks == 1
    assert counter()() == pytest.approx(time.clock_gettime(time.CLOCK_BOOTTIME), abs=1)


def test_without_boottime_the_monotonic_clock_is_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(time, "CLOCK_BOOTTIME")
    assert counter()() == pytest.approx(time.monotonic(), abs=1)


@pytest.mark.parametrize("off", [-SKEW, 0, SKEW])
def test_another_clock_corrects_one_that_was_wrong(host: Host, off: int) -> None:
    host.shows += 3600
    host.passes(1)
    host.shows -= 3600
    assert host.clock.time() == BEGIN + 3601
    assert host.clock.correct(int(BEGIN) + 1 + off)
    assert host.clock.time() == BEGIN + 1
    assert not host.clock.correct(int(BEGIN) + 1), "nothing is to be corrected"


def test_another_clock_that_agrees_with_neither_changes_nothing(host: Host) -> None:
    host.shows -= 3600
    for moment in (BEGIN, BEGIN - 3600 + SKEW + 1, BEGIN - 3600 - SKEW - 1, 0):
        assert not host.clock.correct(int(moment))
        assert host.clock.time() == BEGIN


def test_another_clock_does_not_set_one_that_was_not_set_back(host: Host) -> None:
    for off in (-SKEW, 0, SKEW):
        assert not host.clock.correct(int(BEGIN) + off)
        assert host.clock.time() == BEGIN


def test_each_part_of_a_process_sees_a_setback_once(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(clock, "HOST", host.clock)
    one, other = Setbacks(), Setbacks()
    assert not one.any_new()
    host.shows -= 3600
    assert (clock.time(), clock.now()) == (BEGIN, int(BEGIN))
    assert [one.any_new(), one.any_new(), other.any_new()] == [True, False, True]
    assert clock.correct(int(BEGIN) - 3600)
    assert clock.now() == int(BEGIN) - 3600


def test_times_are_formatted_in_utc() -> None:
    assert clock.format_time(1_795_000_000) == "2026-11-18 11:06:40 UTC"


# Of the demonstration and of Tab: they only show something, and nothing is decided by it.
_MEASURES = {"demo/steps.py", "demo/subscriber.py", "cli/completion/sources.py"}


def test_no_other_module_reads_the_hosts_clock() -> None:
    package = Path(rossec.__file__).parent
    asking = {
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if re.search(r"\btime\.time\b(?!_ns)|^import time as", path.read_text(), re.MULTILINE)
    }
    assert asking == {"clock.py", *_MEASURES}


@pytest.mark.parametrize(
    ("seconds", "shown"), [(0, "0s"), (59, "59s"), (900, "15m"), (899, "14m 59s"), (7 * 86400 + 61, "7d 1m")]
)
def test_durations_are_formatted_in_two_units(seconds: int, shown: str) -> None:
    assert clock.format_duration(seconds) == shown


@pytest.mark.parametrize(("hour", "minute", "left"), [(0, 0, 86400), (12, 0, 43200), (23, 59, 60)])
def test_today_ends_at_midnight(hour: int, minute: int, left: int) -> None:
    moment = int(time.mktime((2026, 5, 4, hour, minute, 0, 0, 0, -1)))
    assert clock.seconds_left_today(moment) == left
    assert clock.seconds_left_today(moment + 59) == max(60, left - 59)
