import io
import sys
import threading

import pytest

from rossec import terminal
from rossec.cli.shared import options


class Terminal(io.StringIO):
    """Stderr of a person; `drawn` is set when a line was drawn."""

    def __init__(self) -> None:
        super().__init__()
        self.drawn = threading.Event()

    def isatty(self) -> bool:
        return True

    def write(self, text: str) -> int:
        count = super().write(text)
        if " s)" in text:
            self.drawn.set()
        return count


def at_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Not a fixture: pytest puts its own stderr back before the test begins."""
    found = Terminal()
    monkeypatch.setattr(sys, "stderr", found)
    monkeypatch.setattr(options, "AFTER", 0.01)
    return found


def lines(text: str) -> list[str]:
    """What a terminal still shows of `text`."""
    return [line.rpartition("\r\x1b[K")[2] for line in text.split("\n")]


def test_what_takes_long_is_said_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = at_terminal(monkeypatch)
    with options.working("encrypting\x1b[2J"):
        assert shown.drawn.wait(60)
    assert "encrypting\\u001b[2J (0 s)" in shown.getvalue()
    assert lines(shown.getvalue()) == [""]
    assert terminal.TEMPORARY == []


def test_it_gives_way_to_what_is_printed(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = at_terminal(monkeypatch)
    with options.working("delivering"):
        assert shown.drawn.wait(60)
        terminal.note("the master has it")
        shown.drawn.clear()
        assert shown.drawn.wait(60), "it comes back"
    assert lines(shown.getvalue()) == ["rossec: the master has it", ""]


def test_it_is_gone_when_the_work_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = at_terminal(monkeypatch)

    def work() -> None:
        with options.working("delivering"):
            assert shown.drawn.wait(60)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        work()
    assert lines(shown.getvalue()) == [""]


def test_what_is_quick_is_not_mentioned(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = at_terminal(monkeypatch)
    monkeypatch.setattr(options, "AFTER", 3600.0)
    with options.working("nothing"):
        pass
    assert shown.getvalue() == ""


def test_programs_never_see_it(monkeypatch: pytest.MonkeyPatch) -> None:
    at_terminal(monkeypatch)
    with options.working("x", quiet=True):
        assert terminal.TEMPORARY == []
    token = terminal.FACTS.set({})
    with options.working("x"):
        assert terminal.TEMPORARY == []
    terminal.FACTS.reset(token)
    monkeypatch.setattr(sys, "stderr", io.StringIO())
    with options.working("x"):
        assert terminal.TEMPORARY == []


def test_a_terminal_that_is_gone_is_no_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = at_terminal(monkeypatch)
    with options.working("x"):
        assert shown.drawn.wait(60)
        shown.close()
    assert terminal.TEMPORARY == []
