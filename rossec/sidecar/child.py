"""The program a private sidecar was started for: its environment, its signals, its end. A shell.

The program gets the loopback master in its environment, nothing else: no secret is there or on its
command line. It inherits the descriptors passed to us, as with `<(...)` of a shell, and its own limit of
them. Its orphans become our children (subreaper), so that they remain its descendants. Signals of other
processes are forwarded; only signalfd(2) tells them from those of the kernel.
"""

import asyncio
import contextlib
import ctypes
import json
import os
import resource
import signal
import struct
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from typing import Final, TypeAlias

from ca.errors import HintedError
from rossec.errors import ConfigurationError
from rossec.host.local_ports import LOOPBACK, Loopback

Limits: TypeAlias = tuple[int, int]  # the soft and the hard one
ENOUGH: Final = 1 << 16
_WHICH: Final = resource.RLIMIT_NOFILE
OUTSIDE: Final = "ROSSEC_OUTSIDE"  # in it a nested `rossec run` finds what the outer one replaced
_REPLACED: Final = ("ROS_MASTER_URI", "ROS_IP", "ROS_HOSTNAME", "ROS_IPV6")
_NAMES: Final = ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGUSR1", "SIGUSR2", "SIGCONT")
_FORWARDED: Final = tuple(signal.Signals[name] for name in _NAMES)
_TOOLS: Final = ("rosbag", "roslaunch", "rosmsg", "rosnode", "rosparam", "rosservice", "rostopic")
_PACKAGES: Final = {  # of Debian, for a tool that is not installed
    **dict.fromkeys(("rosrun", "roscd", "rosed"), "rosbash"),
    "rviz": "rviz",
    **{tool: f"python3-{tool}" for tool in _TOOLS},
}
_NOT_FOUND, _NOT_EXECUTABLE, _SIGNALLED = 127, 126, 128
_SUBREAPER: Final = 36  # PR_SET_CHILD_SUBREAPER
_DEATH_SIGNAL: Final = 1  # PR_SET_PDEATHSIG
LIBC: Final = ctypes.CDLL(None, use_errno=True)
_SIGNAL: Final = struct.Struct("=Iii116x")  # signalfd_siginfo: number, errno, code; 128 bytes
_BY_KERNEL: Final = 0x80  # SI_KERNEL


def raise_limit() -> Limits:
    # Every connection of a program needs two descriptors here. The usual soft limit of 1024 is for programs
    # that use select(2), which this process does not. The program may, so it gets the original limit.
    before = resource.getrlimit(_WHICH)
    soft, hard = before
    wanted = ENOUGH if hard == resource.RLIM_INFINITY else min(hard, ENOUGH)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        with suppress(OSError, ValueError):  # a container may forbid it
            resource.setrlimit(_WHICH, (wanted, hard))
    return before


def restore_limit(before: Limits) -> None:
    resource.setrlimit(_WHICH, before)


def outer_environment(environ: Mapping[str, str]) -> dict[str, str]:
    saved = environ.get(OUTSIDE)
    if saved is None:
        return dict(environ)
    try:
        values = dict(json.loads(saved))
        before = {key: str(values[key]) for key in _REPLACED if key in values}
    except (ValueError, TypeError) as error:
        raise ConfigurationError(f"{OUTSIDE} is damaged", f"unset {OUTSIDE}") from error
    return {key: value for key, value in environ.items() if key not in _REPLACED} | before


def program_environment(
    environ: Mapping[str, str], settled: Mapping[str, str], master_uri: str, loopback: Loopback = LOOPBACK
) -> dict[str, str]:
    before = {key: settled[key] for key in _REPLACED if key in settled}
    unchanged = {key: value for key, value in environ.items() if key not in _REPLACED}
    own = {"ROS_IP": loopback.host}
    if loopback != LOOPBACK:
        own = {"ROS_HOSTNAME": loopback.host, "ROS_IPV6": "on"}
    return unchanged | own | {"ROS_MASTER_URI": master_uri, OUTSIDE: json.dumps(before)}


def adopt_orphans() -> None:
    if LIBC.prctl(_SUBREAPER, 1, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl PR_SET_CHILD_SUBREAPER")


async def run(command: Sequence[str], environ: Mapping[str, str], limits: Limits | None = None) -> int:
    with _blocked_signals() as (mask, signals):

        def prepare() -> None:
            # A program whose sidecar was killed has no connections left and must end.
            LIBC.prctl(_DEATH_SIGNAL, signal.SIGTERM, 0, 0, 0)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
            if limits is not None:
                restore_limit(limits)

        try:
            # Its descriptors stay open: what was passed to us is for it, as with `<(...)` of a shell.
            program = await asyncio.create_subprocess_exec(
                *command, env=dict(environ), preexec_fn=prepare, close_fds=False
            )
        except FileNotFoundError:
            raise NoSuchProgram(f"{command[0]}: there is no such program", _NOT_FOUND, command[0]) from None
        except OSError as error:
            reason = error.strerror or "no reason given"
            raise NoSuchProgram(f"{command[0]} cannot be executed: {reason}", _NOT_EXECUTABLE) from None
        with _forwarding_signals(program, signals):
            code = await program.wait()
    return code if code >= 0 else _SIGNALLED - code


class NoSuchProgram(HintedError):
    """The command line names no program; `code` is what a shell would exit with."""

    def __init__(self, message: str, code: int, name: str = "") -> None:
        package = _PACKAGES.get(name)
        install = f"Debian's package of it: apt install {package}"
        super().__init__(message, install if package else "is it installed, and in PATH?")
        self.code = code


@contextlib.contextmanager
def _blocked_signals() -> Iterator[tuple[set[int | signal.Signals], int]]:
    # They are blocked before the program starts: none is lost.
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, _FORWARDED)
    try:
        wanted = ctypes.create_string_buffer(128)  # sigset_t
        LIBC.sigemptyset(wanted)
        for number in _FORWARDED:
            LIBC.sigaddset(wanted, number)
        signals: int = LIBC.signalfd(-1, wanted, os.O_CLOEXEC | os.O_NONBLOCK)
        if signals < 0:
            raise OSError(ctypes.get_errno(), "signalfd")
        try:
            yield mask, signals
        finally:
            os.close(signals)
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, mask)


@contextlib.contextmanager
def _forwarding_signals(program: asyncio.subprocess.Process, signals: int) -> Iterator[None]:
    loop = asyncio.get_running_loop()

    def forward() -> None:
        with suppress(BlockingIOError):
            while True:
                number, _, code = _SIGNAL.unpack(os.read(signals, _SIGNAL.size))
                # Those of the kernel (Ctrl-C) the terminal has sent to the program as well.
                if code != _BY_KERNEL:
                    with suppress(ProcessLookupError):
                        program.send_signal(number)

    def reap_orphans() -> None:
        with suppress(ChildProcessError):
            while (found := os.waitid(os.P_ALL, 0, os.WEXITED | os.WNOHANG | os.WNOWAIT)) is not None:
                if found.si_pid == program.pid:  # asyncio waits for that one
                    return
                os.waitpid(found.si_pid, os.WNOHANG)

    loop.add_reader(signals, forward)
    loop.add_signal_handler(signal.SIGCHLD, reap_orphans)
    try:
        yield
    finally:
        forward()  # a signal that came last was for the program and must not end us
        loop.remove_reader(signals)
        loop.remove_signal_handler(signal.SIGCHLD)
