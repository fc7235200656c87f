"""Commands at a real terminal: colour beside words, what takes long, and Ctrl-C at any moment."""

import os
import pty
import select
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.support.commands import PASSPHRASE, Shell

ROSSEC = str(Path(sys.executable).with_name("rossec"))
RED_ERROR = "rossec: \x1b[31merror:\x1b[0m there is no authority"


class Person:
    """Somebody at a terminal, in front of one command."""

    def __init__(self, words: list[str], environ: dict[str, str]) -> None:
        self.shown = ""
        self._child, self._terminal = pty.fork()
        if self._child == 0:
            os.execve(ROSSEC, [ROSSEC, *words], environ)

    def wait_for(self, text: str, within: float = 60) -> None:
        ends = time.monotonic() + within
        while text not in self.shown:
            assert time.monotonic() < ends, self.shown
            assert self._read(), self.shown

    def press(self, keys: str) -> None:
        os.write(self._terminal, keys.encode())

    def interrupt(self) -> int:
        """Press Ctrl-C, again where the program was not reading yet; returns as `end`."""
        self.press("\x03")
        while self._read(1, "\x03"):
            pass
        return self.end()

    def end(self) -> int:
        """Wait for its end; returns the exit code, or minus the signal."""
        while self._read():
            pass
        os.close(self._terminal)
        return os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])

    def _read(self, within: float = 60, otherwise: str = "") -> bool:
        if not select.select([self._terminal], [], [], within)[0]:
            self.press(otherwise)
            return bool(otherwise)
        try:
            part = os.read(self._terminal, 4096).decode(errors="replace")
        except OSError:  # Linux: the other end is closed
            return False
        self.shown += part
        return bool(part)


def at(shell: Shell, *words: str, **variables: str) -> Person:
    environ = {name: value for name, value in os.environ.items() if name != "NO_COLOR"}
    return Person([*words], {**environ, **shell.environ, "NO_COLOR": "", "TERM": "xterm", **variables})


def test_an_error_is_red_and_says_so(empty: Shell) -> None:
    person = at(empty, "ca", "show")
    assert person.end() == 1
    assert RED_ERROR in person.shown
    assert "rossec: \x1b[1mhint:\x1b[0m next: rossec ca init DOMAIN" in person.shown


@pytest.mark.parametrize("variables", [{"NO_COLOR": "1"}, {"TERM": "dumb"}])
def test_who_wants_no_colour_gets_none(empty: Shell, variables: dict[str, str]) -> None:
    person = at(empty, "ca", "show", **variables)
    assert person.end() == 1
    assert "rossec: error: there is no authority" in person.shown
    assert "\x1b" not in person.shown


def test_a_pipe_gets_no_colour(empty: Shell) -> None:
    environ = {**os.environ, **empty.environ, "NO_COLOR": "", "TERM": "xterm"}
    command = [ROSSEC, "ca", "show"]
    done = subprocess.run(command, env=environ, capture_output=True, text=True, check=False)
    assert "\x1b" not in done.stderr


def test_a_state_has_its_colour(shell: Shell) -> None:
    shell.enroll("/robot")
    person = at(shell, "doctor", "/robot", ROS_MASTER_URI="http://127.0.0.1:1")
    assert person.end() == 1
    assert "\x1b[32mok    \x1b[0m  /robot of home" in person.shown
    assert "\x1b[31mnot ok\x1b[0m  " in person.shown


def test_a_long_wait_is_said_and_taken_away(shell: Shell) -> None:
    shell.enroll("/robot")
    person = at(shell, "discover", "--as", "/robot", "--seconds", "600")
    person.wait_for("listening for masters (1 s)")
    assert person.interrupt() in {130, -signal.SIGINT}
    assert person.shown.replace("^C", "").rpartition("\r\x1b[K")[2].strip() == ""


PROMPTS = {
    "a passphrase": (("ca", "refresh"), "passphrase"),
    "a new passphrase": (("ca", "init", "other"), "new passphrase"),
    "yes or no": (("ca", "sign", "REQUEST"), "[y/N]"),
    "a code": (("ca", "enroll"), ":"),
}


@pytest.mark.parametrize("name", PROMPTS)
def test_ctrl_c_at_a_prompt_is_quiet(shell: Shell, empty: Shell, name: str) -> None:
    words, prompt = PROMPTS[name]
    request = str(shell.node("/robot") / "node.csr")
    if name == "yes or no":
        assert shell("node", "request", "/robot").code == 0
    variables = {"ROSSEC_HOME": str(shell.root / "new")} if name == "a new passphrase" else {}
    person = at(shell, *(request if word == "REQUEST" else word for word in words), **variables)
    person.wait_for(prompt)
    assert person.interrupt() in {130, -signal.SIGINT}
    assert "Traceback" not in person.shown
    assert "rror" not in person.shown
    assert PASSPHRASE not in person.shown


RUNNING = {
    "an enrollment": (("node", "enroll", "/robot", "--address", "127.0.0.1"), "ROSSEC:"),
    "the service": (("ca", "serve", "--no-network"), "passphrase"),
    "a search": (("discover", "--as", "/robot", "--seconds", "600"), "listening"),
}


@pytest.mark.parametrize("name", RUNNING)
def test_ctrl_c_in_a_long_command_is_quiet(shell: Shell, name: str) -> None:
    words, shown = RUNNING[name]
    if name == "a search":
        shell.enroll("/robot")
    person = at(shell, *words)
    person.wait_for(shown)
    assert person.interrupt() in {130, -signal.SIGINT}
    assert "Traceback" not in person.shown
    assert "KeyboardInterrupt" not in person.shown
