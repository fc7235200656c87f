"""A person at a terminal: `python -m tests.support.terminal ANSWER... -- COMMAND...`.

Each prompt (output that ends with a colon and a space) gets the next answer; `^C` is Ctrl-C,
pressed again when nothing happens. The output of the command is forwarded; its exit code becomes
this program's.
"""

import os
import pty
import select
import signal
import sys
from collections.abc import Iterator

_INTERRUPT = b"\x03"
_PATIENCE = 5.0  # seconds


def main(answers: Iterator[str], command: list[str]) -> int:
    """Run `command` on its own terminal."""
    child, terminal = pty.fork()
    if child == 0:
        signal.signal(signal.SIGHUP, signal.SIG_DFL)  # a test run by nohup ignores it
        os.execvp(command[0], command)
    said, typed = b"", b""
    while part := _read(terminal, typed):
        os.write(1, part)
        said += part
        if said.endswith(b": "):
            answer = next(answers, "^C")
            typed = _INTERRUPT if answer == "^C" else answer.encode() + b"\n"
            os.write(terminal, typed)
            said = b""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _read(terminal: int, typed: bytes) -> bytes:
    """The next output; Ctrl-C is repeated for a program that was not reading yet."""
    while typed == _INTERRUPT and not select.select([terminal], [], [], _PATIENCE)[0]:
        os.write(terminal, typed)
    try:
        return os.read(terminal, 4096)
    except OSError:  # Linux: the other end is closed
        return b""


if __name__ == "__main__":
    split = sys.argv.index("--")
    sys.exit(main(iter(sys.argv[1:split]), sys.argv[split + 1 :]))
