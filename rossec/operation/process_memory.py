"""A process whose memory holds a key: nobody else may read it, and it is never written to disk.

Without this every program of the same user could attach a debugger, and a crash would write the
key into a core file (attack of the same user: ptrace(2), core(5)). Memory that is swapped out is
not covered: where there is swap it must be encrypted, or kept away by the service manager.
"""

import ctypes
import resource
from typing import Final

_PR_GET_DUMPABLE: Final = 3
_PR_SET_DUMPABLE: Final = 4
_PR_SET_NO_NEW_PRIVS: Final = 38
LIBC: Final = ctypes.CDLL(None, use_errno=True)


def protect_memory() -> None:
    """Let no process of the same user read this one's memory, and write no core file.

    Programs started later are not affected, but cannot gain privileges (set-user-id).

    Raises:
        OSError: the kernel refuses.
    """
    _prctl(_PR_SET_DUMPABLE, 0)
    _prctl(_PR_SET_NO_NEW_PRIVS, 1)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def is_protected() -> bool:
    """Whether this process is not dumpable."""
    return _prctl(_PR_GET_DUMPABLE, 0) == 0


def _prctl(option: int, value: int) -> int:
    result: int = LIBC.prctl(option, value, 0, 0, 0)
    if result < 0:
        raise OSError(ctypes.get_errno(), f"prctl {option}")
    return result
