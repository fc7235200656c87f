"""What a stranger's text looks like in a log."""

import pytest

from rossec.peer_limits import TEXT_LIMIT, printable


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("camera 1: caf\u00e9 \u65e5", "camera 1: caf\u00e9 \u65e5"),
        ("a\nrossec: WARNING: b", "a\\u000arossec: WARNING: b"),
        ("\r\t\x00\x1b[31m\x7f\x9b", "\\u000d\\u0009\\u0000\\u001b[31m\\u007f\\u009b"),
        ("\u2028\u2029\u202e\ue000\ud800", "\\u2028\\u2029\\u202e\\ue000\\ud800"),
        ("\U000e0041", "\\U000e0041"),
        ("", ""),
        (5, "5"),
        (ValueError("a\nb"), "a\\u000ab"),
    ],
)
def test_one_printable_line(text: object, shown: str) -> None:
    assert printable(text) == shown


def test_it_is_bounded() -> None:
    assert printable("x" * TEXT_LIMIT) == "x" * TEXT_LIMIT
    assert printable("x" * 10_000) == "x" * TEXT_LIMIT + "..."
    assert printable("xyz", limit=2) == "xy..."
