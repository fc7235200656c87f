"""The `rossec` program, and `python -I -m rossec`, with PYTHONPATH ignored (docs/decisions/0002).

Ctrl-C is quiet at any moment: while modules are imported and while Python ends it ends the process
as in any other program, in between `rossec.cli` gets it.
"""

import contextlib
import os
import signal
import sys
from typing import Final, NoReturn

INTERRUPTED: Final = 130  # as `rossec.terminal` has it
COMPLETE: Final = "_ROSSEC_COMPLETE"  # set by the scripts of `rossec completion`


def main() -> NoReturn:
    heard = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else it is ignored
    if heard:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    if COMPLETE in os.environ:
        complete()
    from rossec.cli.main import main as command_line  # noqa: PLC0415 - it takes time

    try:
        if heard:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        command_line()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)
    finally:
        if heard:
            signal.signal(signal.SIGINT, signal.SIG_DFL)


def complete() -> NoReturn:
    with contextlib.suppress(Exception):
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stderr.fileno())
        from rossec.cli.main import complete as completed  # noqa: PLC0415 - as above

        sys.stdout.write(completed(os.environ))
        sys.stdout.flush()
    os._exit(0)  # nothing is left to close, and a reader that went away is no error


if __name__ == "__main__":
    main()
