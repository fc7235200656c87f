"""The program a private sidecar was started for: its environment, its signals, its end.

A shell. The program finds the loopback master in its environment, nothing else: no secret is there
or on its command line. Programs it leaves behind become our children (subreaper), so that they
stay its own; what another process sends us is passed on, as if the program had been started
without us.
"""

import asyncio
import contextlib
import ctypes
import json
import os
import signal
import sys
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.sidecar.addresses import LOOPBACK

OUTSIDE: Final = "ROSSEC_OUTSIDE"
"""Where a nested `rossec run` finds what the outer one replaced."""

_REPLACED: Final = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ROS_IPV6")
_PASSED_ON: Final = (
    signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT,
    signal.SIGUSR1, signal.SIGUSR2, signal.SIGCONT,
)  # fmt: skip
_FROM_TERMINAL: Final = frozenset({signal.SIGINT, signal.SIGQUIT})
_NOT_FOUND, _NOT_EXECUTABLE, _SIGNALLED = 127, 126, 128
_SUBREAPER: Final = 36  # PR_SET_CHILD_SUBREAPER
_DEATH_SIGNAL: Final = 1  # PR_SET_PDEATHSIG
_LIBC: Final = ctypes.CDLL(None, use_errno=True)


def outside(environ: Mapping[str, str]) -> dict[str, str]:
    """The environment as it was before an outer `rossec run` changed it.

    Raises:
        ConfigurationError: the variable that says so is damaged.
    """
    saved = environ.get(OUTSIDE)
    if saved is None:
        return dict(environ)
    try:
        values = dict(json.loads(saved))
        before = {key: str(values[key]) for key in _REPLACED if key in values}
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{OUTSIDE} is damaged", f"unset {OUTSIDE}") from error
    return {key: value for key, value in environ.items() if key not in _REPLACED} | before


def inside(environ: Mapping[str, str], master_uri: str) -> dict[str, str]:
    """The environment for the program."""
    before = {key: value for key, value in outside(environ).items() if key in _REPLACED}
    kept = {key: value for key, value in environ.items() if key not in _REPLACED}
    return kept | {"ROS_MASTER_URI": master_uri, "ROS_IP": LOOPBACK, OUTSIDE: json.dumps(before)}


def adopt_orphans() -> None:
    """Become the parent of what the program leaves behind.

    Raises:
        OSError: the kernel does not let us.
    """
    if _LIBC.prctl(_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl PR_SET_CHILD_SUBREAPER")


def _end_with_parent() -> None:
    """In the child: a program whose sidecar was killed reaches nobody, and must not linger."""
    _LIBC.prctl(_DEATH_SIGNAL, signal.SIGTERM, 0, 0, 0)


async def run(command: Sequence[str], environ: Mapping[str, str]) -> int:
    """Run the program to its end; its exit code, 128 and the signal's number if one ended it."""
    try:
        program = await asyncio.create_subprocess_exec(
            *command, env=dict(environ), preexec_fn=_end_with_parent
        )
    except FileNotFoundError:
        raise NoSuchProgram(f"{command[0]}: there is no such program", _NOT_FOUND) from None
    except PermissionError:
        raise NoSuchProgram(f"{command[0]} cannot be executed", _NOT_EXECUTABLE) from None
    with _passing_on(program):
        code = await program.wait()
    return code if code >= 0 else _SIGNALLED - code


class NoSuchProgram(HintedError):
    """The command line names no program; `code` is what a shell would exit with."""

    def __init__(self, message: str, code: int) -> None:
        super().__init__(message, "give the program after --, with its arguments")
        self.code = code


@contextlib.contextmanager
def _passing_on(program: asyncio.subprocess.Process) -> Iterator[None]:
    loop = asyncio.get_running_loop()

    def pass_on(number: signal.Signals) -> None:
        if number in _FROM_TERMINAL and _in_foreground():
            return  # the terminal has sent it to the program as well
        with contextlib.suppress(ProcessLookupError):
            program.send_signal(number)

    for number in _PASSED_ON:
        loop.add_signal_handler(number, pass_on, number)
    loop.add_signal_handler(signal.SIGCHLD, _bury, program.pid)
    try:
        yield
    finally:
        for number in (*_PASSED_ON, signal.SIGCHLD):
            loop.remove_signal_handler(number)


def _in_foreground() -> bool:
    try:
        return os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except (OSError, ValueError):
        return False


def _bury(own: int) -> None:
    """Collect adopted children that have ended; the program itself is waited for elsewhere."""
    with contextlib.suppress(ChildProcessError):
        while (found := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
            if found.si_pid == own:
                return
            os.waitpid(found.si_pid, os.WNOHANG)
