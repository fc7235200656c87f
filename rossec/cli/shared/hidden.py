"""What is typed or pasted without being shown: a passphrase, the code of an invitation.

`getpass` reads one line and throws away what is pasted behind it. A code from a mail has line
breaks, so lines are taken until it is whole.
"""

import os
import sys
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

_MORE: Final = "the code goes on, or Enter to end: "
_MAX_LINES: Final = 32
_LINE: Final = 4096  # octets; a terminal gives no longer ones


def can_hide() -> bool:
    """Whether there is a terminal whose echo can be turned off: as `getpass` looks for one."""
    try:
        os.close(os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY))
    except OSError:
        return sys.stdin is not None and sys.stdin.isatty()
    return True


def read_lines(question: str, is_whole: Callable[[str], bool]) -> str:
    """Lines from the terminal, not shown, until `is_whole`, an empty one or the end.

    Raises:
        OSError: there is no terminal.
        KeyboardInterrupt: Ctrl-C.
    """
    with _without_echo() as terminal:
        os.write(terminal, f"{question}: ".encode())
        lines = list[str]()
        while len(lines) < _MAX_LINES:
            line = os.read(terminal, _LINE).decode(errors="replace")
            lines.append(line)
            if not line.strip() or is_whole("".join(lines)):
                break
            os.write(terminal, f"\n{_MORE}".encode())
        os.write(terminal, b"\n")
    return "".join(lines)


@contextmanager
def _without_echo() -> Iterator[int]:
    """The terminal of this process, as it was afterwards; what was not read then is gone."""
    terminal = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY)
    try:
        before = termios.tcgetattr(terminal)
        hidden = [*before[:3], before[3] & ~termios.ECHO, *before[4:]]
        termios.tcsetattr(terminal, termios.TCSADRAIN, hidden)
        try:
            yield terminal
        finally:  # a rest of a paste must not reach the shell
            termios.tcsetattr(terminal, termios.TCSAFLUSH, before)
    finally:
        os.close(terminal)
