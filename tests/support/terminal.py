"""A person at a terminal: `python -m tests.support.terminal ANSWER... -- COMMAND...`.

Each prompt (output that ends with a colon and a space) gets the next answer; `^C` is Ctrl-C. What
the command says is passed on; its exit code becomes this program's.
"""

import os
import pty
import sys
from collections.abc import Iterator


def main(answers: Iterator[str], command: list[str]) -> int:
    """Run `command` on a terminal of its own."""
    child, terminal = pty.fork()
    if child == 0:
        os.execvp(command[0], command)
    said = b""
    while part := _read(terminal):
        os.write(1, part)
        said += part
        if said.endswith(b": "):
            answer = next(answers, "^C")
            os.write(terminal, b"\x03" if answer == "^C" else answer.encode() + b"\n")
            said = b""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def _read(terminal: int) -> bytes:
    try:
        return os.read(terminal, 4096)
    except OSError:  # Linux: the other side is closed
        return b""


if __name__ == "__main__":
    split = sys.argv.index("--")
    sys.exit(main(iter(sys.argv[1:split]), sys.argv[split + 1 :]))
