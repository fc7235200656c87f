"""What is typed or pasted without being shown, at a terminal of its own."""

import os
import pty
import signal
import sys
import termios
from collections.abc import Callable, Iterator

import pytest

from rossec.cli.shared import passphrase

PROGRAM = """
import sys
from rossec.cli.shared.passphrase import can_hide, read_lines
assert can_hide()
found = read_lines("paste", lambda text: "".join(text.split()).endswith("END"))
print("GOT", "".join(found.split()), flush=True)
sys.stdin.readline() == "after\\n" and print("AFTER", flush=True)
"""
Answer = Callable[[bytes], bytes | None]


def at_a_terminal(program: str, answer: Answer) -> bytes:
    """All that a program says at a terminal; `answer` gives what is typed when it has said this."""
    child, terminal = pty.fork()
    if child == 0:
        signal.alarm(60)
        os.execv(sys.executable, [sys.executable, "-c", program])
    said = b""
    try:
        while part := os.read(terminal, 4096):
            said += part
            if (typed := answer(said)) is not None:
                os.write(terminal, typed)
    except OSError:  # Linux: the other end is closed
        pass
    finally:
        os.close(terminal)
        os.waitpid(child, 0)
    return said


def once(*steps: tuple[bytes, bytes]) -> Answer:
    left = list(steps)

    def answer(said: bytes) -> bytes | None:
        if left and said.endswith(left[0][0]):
            return left.pop(0)[1]
        return None

    return answer


def test_a_paste_with_line_breaks_is_taken_whole_and_not_shown() -> None:
    typed = once((b"paste: ", b"SECRET-a\n  b\n\tc END\n"))
    said = at_a_terminal(PROGRAM.replace("sys.stdin.readline()", "''"), typed)
    assert b"GOT SECRET-abcEND" in said
    assert said.count(b"SECRET") == 1  # by the program, not by the echo of the terminal


def test_an_empty_line_ends_it() -> None:
    said = at_a_terminal(
        PROGRAM.replace("sys.stdin.readline()", "''"), once((b"paste: ", b"half\n"), (b"to end: ", b"\n"))
    )
    assert b"GOT half" in said


def test_the_terminal_is_as_before_and_the_rest_of_a_paste_is_gone() -> None:
    said = at_a_terminal(PROGRAM, once((b"paste: ", b"x END\nrm -rf\n"), (b"GOT xEND\r\n", b"after\n")))
    assert b"AFTER" in said
    assert b"after\r\nAFTER" in said  # it is echoed again


def test_the_lines_are_bounded() -> None:
    said = at_a_terminal(PROGRAM.replace("sys.stdin.readline()", "''"), once((b"paste: ", b"z\n" * 64)))
    assert b"GOT " + b"z" * 32 + b"\r\n" in said


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The other end of what this process has for its terminal."""
    outer, inner = pty.openpty()
    plain = os.open

    def opened(path: str, flags: int) -> int:
        return os.dup(inner) if path == "/dev/tty" else plain(path, flags)

    monkeypatch.setattr("rossec.cli.shared.passphrase.os.open", opened)
    yield outer
    os.close(outer)
    os.close(inner)


@pytest.mark.parametrize(
    ("typed", "taken"),
    [(b"one\n  two END\nrest\n", "oneEND"), (b"half\n\n", "half"), (b"z\n" * 40, "z" * 32)],
    ids=["whole", "an empty line", "too many"],
)
def test_lines_are_taken_until_the_code_is_whole(terminal: int, typed: bytes, taken: str) -> None:
    os.write(terminal, typed)
    assert passphrase.can_hide()
    found = "".join(passphrase.read_lines("paste", lambda text: "END" in text).split())
    assert found.replace("two", "") == taken
    said = b""
    while b"paste: " not in said:
        said += os.read(terminal, 65536)
    assert termios.tcgetattr(terminal)[3] & termios.ECHO


def test_without_a_terminal_nothing_can_be_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(*_: object) -> int:
        raise OSError(6, "No such device or address")

    monkeypatch.setattr(os, "open", refused)
    monkeypatch.setattr(sys, "stdin", None)
    assert not passphrase.can_hide()
    with pytest.raises(OSError, match="No such device"):
        passphrase.read_lines("paste", bool)
