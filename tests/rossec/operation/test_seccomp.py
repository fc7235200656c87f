"""A filter of system calls: what it lets through, on the real kernel and by its own text."""

import errno
import platform
import struct
import subprocess
import sys

import pytest

from rossec.host import sandbox

KILL, ALLOW, REFUSE = 0x80000000, 0x7FFF0000, 0x00050001
X86_64, AARCH64 = 0xC000003E, 0xC00000B7
FORK = 0x01200011
NEEDED = (
    "brk",
    "close",
    "exit_group",
    "fstat",
    "futex",
    "getrandom",
    "lseek",
    "madvise",
    "mmap",
    "munmap",
    "read",
    "rt_sigaction",
    "rt_sigprocmask",
    "write",
)


def judged(code: bytes, architecture: int, number: int, first: int = 0) -> int:
    """What the kernel does with a call: the filter interpreted, as BPF is."""
    data = struct.pack("<IIQQ", number, architecture, 0, first) + bytes(40)
    accumulator, at = 0, 0
    while True:
        what, equal, other, constant = struct.unpack_from("<HBBI", code, at * 8)
        if what == 0x06:
            return int(constant)
        if what == 0x20:
            (accumulator,) = struct.unpack_from("<I", data, constant)
        elif what == 0x15:
            at += equal if accumulator == constant else other
        else:
            pytest.fail(f"instruction {what:x}")
        at += 1


def test_calls_on_the_list_pass_and_others_fail() -> None:
    code = sandbox.program(["read", "write"], "x86_64")
    assert [judged(code, X86_64, number) for number in (0, 1)] == [ALLOW, ALLOW]
    for number in (2, 41, 56, 57, 58, 59, 101, 257, 322, 435, 0x40000001):
        assert judged(code, X86_64, number) == REFUSE


def test_another_architecture_ends_the_process() -> None:
    code = sandbox.program(["read"], "x86_64")
    for architecture in (AARCH64, 0x40000003, 0):
        assert judged(code, architecture, 0) == KILL


def test_arm_has_its_own_numbers() -> None:
    code = sandbox.program(["read", "write", sandbox.FORK], "aarch64")
    assert [judged(code, AARCH64, number) for number in (63, 64, 0, 1)] == [ALLOW, ALLOW, REFUSE, REFUSE]
    assert judged(code, AARCH64, 220, FORK) == ALLOW
    assert judged(code, AARCH64, 221) == REFUSE


@pytest.mark.parametrize(
    "flags", [0, 17, 0x10000000 | FORK, 0x00010F00, 1 << 32 | FORK, FORK | 0x100, 0x40000000]
)
def test_only_a_plain_fork_is_one(flags: int) -> None:
    code = sandbox.program([sandbox.FORK], "x86_64")
    assert judged(code, X86_64, 56, FORK) == ALLOW
    assert judged(code, X86_64, 56, flags) == REFUSE
    assert judged(code, X86_64, 435) == REFUSE  # clone3: its flags are in memory


@pytest.mark.parametrize("machine", ["armv7l", "riscv64", "i686", ""])
def test_nothing_is_done_on_unknown_machines(machine: str) -> None:
    with pytest.raises(OSError, match="no filter of system calls is known"):
        sandbox.program(["read"], machine)


def test_the_numbers_are_those_of_this_kernel() -> None:
    """Each call that glibc makes on its own is one that the table means."""
    assert platform.machine() in ("x86_64", "aarch64")
    column = 0 if platform.machine() == "x86_64" else 1
    assert len({row[column] for row in sandbox._NUMBERS.values()}) == len(sandbox._NUMBERS)


PROGRAM = """
import ctypes, os, socket, sys, threading
from rossec.host import sandbox
libc = ctypes.CDLL(None, use_errno=True)
def tried(what):
    try:
        what()
    except OSError as error:
        return error.errno
    except RuntimeError:
        return 1  # can't start new thread
    return 0
null = os.open("/dev/null", os.O_WRONLY)
actions = [
    lambda: os.write(null, b"a"), lambda: os.open("/etc/passwd", os.O_RDONLY),
    lambda: os.open("/tmp/seccomp-made", os.O_WRONLY | os.O_CREAT), socket.socket, os.fork,
    lambda: os.execv("/bin/true", ["true"]), lambda: os.kill(os.getppid(), 0),
    lambda: os.posix_spawn("/bin/true", ["true"], {}), threading.Thread(target=print).start,
    lambda: os.unlink("/tmp/none"), os.listdir, lambda: os.memfd_create("a"), os.pipe,
]
sandbox.allow_only(sys.argv[1:])
os.write(1, repr([tried(action) for action in actions]).encode())
os._exit(0)
"""


def test_the_kernel_refuses_root_too() -> None:
    """Opening, sockets, processes, threads, signals: everything but what computes."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, *NEEDED], capture_output=True, check=False, timeout=60, env={}
    )
    assert done.stderr == b""
    first, *others = eval(done.stdout)
    assert first == 0
    assert set(others) == {errno.EPERM}


def test_without_filters_in_the_kernel_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    class NoKernel:
        def __init__(self, fails: int) -> None:
            self._fails = fails

        def prctl(self, option: int, *_: object) -> int:
            return -1 if option == self._fails else 0

    for option, message in ((38, "prctl"), (22, "seccomp")):
        monkeypatch.setattr(sandbox, "LIBC", NoKernel(option))
        with pytest.raises(OSError, match=message):
            sandbox.allow_only(["read"])
    monkeypatch.setattr(sandbox, "LIBC", NoKernel(0))
    sandbox.allow_only(["read"])
