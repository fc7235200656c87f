import io

import pytest

from rossec import terminal

WANTED = {"TERM": "xterm-256color"}


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.mark.parametrize(
    ("environ", "wanted"),
    [
        (WANTED, True),
        ({**WANTED, "NO_COLOR": ""}, True),
        ({**WANTED, "NO_COLOR": "1"}, False),
        ({"TERM": "dumb"}, False),
        ({}, False),
    ],
)
def test_who_does_not_want_colour_gets_none(environ: dict[str, str], wanted: bool) -> None:
    assert terminal.is_wanted(Terminal(), environ) is wanted
    assert not terminal.is_wanted(io.StringIO(), environ)


def test_a_closed_stream_is_no_terminal() -> None:
    stream = Terminal()
    stream.close()
    assert not terminal.is_wanted(stream, WANTED)


def test_colour_is_beside_the_word(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert terminal.painted_state("ok    ", Terminal()) == "\x1b[32mok    \x1b[0m"
    assert terminal.painted_state("revoked", Terminal()) == "\x1b[31mrevoked\x1b[0m"
    assert terminal.painted_state("something", Terminal()) == "something"
    assert terminal.painted_state("revoked", io.StringIO()) == "revoked"
    assert terminal.paint("error:", terminal.RED, Terminal()) == "\x1b[31merror:\x1b[0m"
    assert terminal.paint("x", "", Terminal()) == "x"
