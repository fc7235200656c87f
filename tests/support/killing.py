"""Kill a process at each of its writes: real processes, stopped by the kernel, killed with -9.

A child is traced (ptrace) from system call to system call; before the n-th one that changes a file
it is killed. The next process finds what was written until then. Only a process with one thread
may fork like this: scenarios run in a separate program.
"""

import ctypes
import os
import platform
import signal
from collections.abc import Callable

TRACEME, SYSCALL, SETOPTIONS, GET_SYSCALL_INFO = 0, 24, 0x4200, 0x420E
SYSGOOD, EXITKILL = 0x1, 0x100000
ENTRY = 1
# By machine: the system calls that change what is on the disk, or sync it.
WRITES = {
    "x86_64": {
        1: "write",
        18: "pwrite64",
        20: "writev",
        74: "fsync",
        75: "fdatasync",
        77: "ftruncate",
        82: "rename",
        83: "mkdir",
        87: "unlink",
        263: "unlinkat",
        264: "renameat",
        285: "fallocate",
        316: "renameat2",
    },
    "aarch64": {
        34: "mkdirat",
        35: "unlinkat",
        38: "renameat",
        46: "ftruncate",
        47: "fallocate",
        64: "write",
        66: "writev",
        68: "pwrite64",
        82: "fsync",
        83: "fdatasync",
        276: "renameat2",
    },
}[platform.machine()]
_libc = ctypes.CDLL(None, use_errno=True)
_libc.ptrace.restype = ctypes.c_long
_libc.ptrace.argtypes = [ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p]


class SyscallInfo(ctypes.Structure):
    """struct ptrace_syscall_info, the fields needed here."""

    _fields_ = (
        ("op", ctypes.c_uint8),
        ("arch", ctypes.c_uint32),
        ("instruction", ctypes.c_uint64),
        ("stack", ctypes.c_uint64),
        ("number", ctypes.c_uint64),
        ("arguments", ctypes.c_uint64 * 6),
    )


def _ptrace(request: int, pid: int, address: int = 0, data: int = 0) -> None:
    if _libc.ptrace(request, pid, address, data) < 0:
        raise OSError(ctypes.get_errno(), f"ptrace request {request:#x}")


def _be_traced(action: Callable[[], None]) -> None:
    """The child: it must never return into its parent's program.

    It leaves without `os._exit`, in which coverage would save: those writes would count too.
    """
    code = 1
    try:
        _ptrace(TRACEME, 0)
        os.kill(os.getpid(), signal.SIGSTOP)
        action()
        code = 0
    finally:
        _libc._exit(code)


def run_killed(action: Callable[[], None], last: int) -> str | None:
    """Run `action` in a child that is killed before its `last`-th write (counted from 1).

    Returns the name of that system call, or None if the child exited before.
    """
    child = os.fork()
    if child == 0:
        _be_traced(action)
    _, status = os.waitpid(child, 0)
    _ptrace(SETOPTIONS, child, 0, SYSGOOD | EXITKILL)
    seen = 0
    while True:
        _ptrace(SYSCALL, child)
        _, status = os.waitpid(child, 0)
        if os.WIFEXITED(status):
            assert os.WEXITSTATUS(status) == 0, "the action failed by itself"
            return None
        assert os.WIFSTOPPED(status), status
        name = _write_at(child) if os.WSTOPSIG(status) == signal.SIGTRAP | 0x80 else None
        seen += name is not None
        if seen == last:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return name


def _write_at(child: int) -> str | None:
    """The name of the child's next system call, if it is a write."""
    info = SyscallInfo()
    _ptrace(GET_SYSCALL_INFO, child, ctypes.sizeof(info), ctypes.addressof(info))
    return WRITES.get(info.number) if info.op == ENTRY else None
