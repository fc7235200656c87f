"""Rates and sizes as rostopic says them."""

import pytest

from rossec.cli.shared.messages import RateWindow, SizeWindow


def test_a_steady_rate() -> None:
    window = RateWindow()
    for number in range(11):
        window.add(100 + number / 10)
    assert window.describe() == (
        "average rate: 10.000\n\tmin: 0.100s max: 0.100s std dev: 0.00000s window: 11"
    )


def test_only_the_last_messages_count() -> None:
    window = RateWindow(3)
    for moment in (0, 100, 101, 103):
        window.add(moment)
    assert window.describe() == ("average rate: 0.667\n\tmin: 1.000s max: 2.000s std dev: 0.50000s window: 3")


def test_silence_is_said() -> None:
    window = RateWindow()
    assert window.describe() == "no new messages"
    window.add(1)
    assert window.describe() == "no new messages"
    window.add(1)
    assert window.describe().startswith("average rate: 0.000")
    assert window.describe() == "no new messages"


@pytest.mark.parametrize(
    ("size", "expected"),
    [
        (10, "average: 20.00B/s\n\tmean: 10.00B min: 10.00B max: 10.00B window: 2"),
        (5000, "average: 10.00KB/s\n\tmean: 5.00KB min: 5.00KB max: 5.00KB window: 2"),
        (2_000_000, "average: 4.00MB/s\n\tmean: 2.00MB min: 2.00MB max: 2.00MB window: 2"),
    ],
)
def test_sizes(size: int, expected: str) -> None:
    window = SizeWindow()
    assert window.describe(0) == "no new messages"
    window.add(0, size)
    assert window.describe(0) == "no new messages"
    window.add(0.5, size)
    assert window.describe(1) == expected


def test_sizes_of_the_last_messages() -> None:
    window = SizeWindow(2)
    for moment, size in ((0, 900), (1, 2), (2, 4)):
        window.add(moment, size)
    assert window.describe(3) == ("average: 3.00B/s\n\tmean: 3.00B min: 2.00B max: 4.00B window: 2")
