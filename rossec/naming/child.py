"""The process that applies rules (`python -I -m rossec.naming.child`): it forks for each request.

Each request has a process of its own, with limits, which nothing outlives. The one that forks only passes
bytes on: no request is left in it for the next. Frames come on standard input.

A process for a request computes and writes into one pipe: it opens no file, has no socket, starts no process
and signals none, also as root (`seccomp`), and dies with the one that forked it.
"""

import ctypes
import gc
import os
import resource
import signal
import sys
from contextlib import suppress
from typing import Final, NoReturn

from ca.errors import EncodingError
from rossec.errors import RossecError, RulesExceeded, RulesNotConfined
from rossec.host import sandbox
from rossec.host.confinement import lower_limits
from rossec.naming import requests
from rossec.naming.xslt import answer

CPU: Final = 2  # seconds for a request
MEMORY: Final = 256 * 1024 * 1024
FILES: Final = 16  # descriptors
_LIMITS: Final = {
    resource.RLIMIT_AS: MEMORY,
    resource.RLIMIT_CORE: 0,
    resource.RLIMIT_FSIZE: 0,
    resource.RLIMIT_NOFILE: FILES,
}
_PR_SET_PDEATHSIG: Final = 1
_NICE: Final = 5  # rules are no reason to slow a robot down
# The system calls of the process for a request, and those beside them of the one that forks it.
_COMPUTE: Final = tuple(
    """brk clock_gettime close exit exit_group fstat futex getpid getrandom gettid lseek madvise mmap mprotect
    mremap munmap read restart_syscall rseq rt_sigaction rt_sigprocmask rt_sigreturn sched_yield
    write""".split()  # noqa: SIM905 - read as a text
)
_FORKS: Final = (
    *_COMPUTE,
    sandbox.FORK,
    *"getppid kill pipe2 prctl prlimit64 readv set_robust_list wait4".split(),  # noqa: SIM905
)
_ENDED: Final = "the rules took more time or memory than allowed, and were ended"
_ENDED_HINT: Final = f"{CPU} s and {MEMORY // 1024 // 1024} MB are allowed for one request"
_WARM_UP: Final = requests.NameRequest(
    b'<xsl:stylesheet version="1.0" xmlns:xsl="http://www.w3.org/1999/XSL/Transform">'
    b'<parameter name="a" path="/node/name" default="b"/><xsl:template match="/node">'
    b'<xsl:if test="$type=\'node\'"><name><xsl:value-of select="$a"/></name></xsl:if>'
    b"</xsl:template></xsl:stylesheet>",
    b"<node><name>c</name></node>",
    ((requests.NameKind.NODE, ""), (requests.NameKind.TOPIC, "d")),
)


def main() -> None:
    answer(_WARM_UP)  # everything that is imported or read later, while files can be opened
    answer(requests.NameRequest(b"<", b""))
    try:
        confine()
    except (OSError, ValueError) as error:
        refusal = RulesNotConfined(
            f"the process for rules cannot be confined: {error}",
            "it needs Linux with seccomp, on x86_64 or aarch64",
        )
        _write(1, requests.frame(requests.write_error(refusal)))
        return
    _write(1, requests.frame(requests.READY))
    serve(0, 1)


def confine() -> None:
    os.nice(_NICE)
    lower_limits(_LIMITS)
    with suppress(OSError):  # no Landlock: the filter forbids to open anything in any case
        sandbox.read_only(())
    os.closerange(3, FILES)
    gc.collect()
    gc.freeze()  # forks share these pages
    sandbox.allow_only(_FORKS)


def serve(source: int, sink: int) -> None:
    while head := _read(source, requests.HEAD):
        body = _read(source, requests.size(bytes(head), requests.MAX_REQUEST))
        given = ask(body)
        _clear(body)
        _write(sink, len(given).to_bytes(requests.HEAD))
        _write(sink, given)
        _clear(given)


def ask(body: bytearray) -> bytearray:
    source, sink = os.pipe()
    own = os.getpid()
    child = os.fork()
    if child == 0:
        work(body, sink, own)
    os.close(sink)
    try:
        given = bytearray()
        while len(given) <= requests.MAX_ANSWER and (piece := os.read(source, 64 * 1024)):
            given += piece
    finally:
        os.close(source)
        os.kill(child, signal.SIGKILL)  # one that has answered has no more to do
        os.waitpid(child, 0)
    if not 0 < len(given) <= requests.MAX_ANSWER:
        return bytearray(requests.write_error(RulesExceeded(_ENDED, _ENDED_HINT)))
    return given


# Rules and metadata are read by libraries written in C, and libxslt bounds neither time nor memory: what goes
# wrong there, or is taken over, ends with this one request.
def work(body: bytearray, sink: int, parent: int) -> NoReturn:
    code = 1
    try:
        restrict(sink, parent)
        _write(sink, _answered(bytes(body)))
        code = 0
    finally:
        os._exit(code)  # whatever happens, no cleanup of the process that forked is run


def restrict(sink: int, parent: int) -> None:
    if sandbox.LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) != 0:
        raise OSError(ctypes.get_errno(), "prctl")
    if os.getppid() != parent:  # it ended before it was asked to take this process along
        raise OSError("nobody waits for the answer")
    os.closerange(0, sink)
    os.closerange(sink + 1, FILES)
    resource.setrlimit(resource.RLIMIT_CPU, (CPU, CPU))
    lower_limits({resource.RLIMIT_NPROC: 0, resource.RLIMIT_NOFILE: 0})
    sandbox.allow_only(_COMPUTE)


def _answered(body: bytes) -> bytes:
    try:
        return answer(requests.read_request(body))
    except (EncodingError, RossecError) as error:
        return requests.write_error(RulesExceeded(f"a request of another form: {error}"))
    except MemoryError:
        return b""


def _read(source: int, size: int) -> bytearray:
    # Exactly `size` bytes, or none at the end: unbuffered, so that nothing is held in advance.
    found = bytearray(size)
    view, at = memoryview(found), 0
    while at < size:
        got = os.readv(source, [view[at:]])
        if got == 0:
            return bytearray()
        at += got
    return found


def _write(sink: int, data: bytes | bytearray) -> None:
    view = memoryview(data)
    while view:
        view = view[os.write(sink, view) :]


def _clear(data: bytearray) -> None:
    data[:] = bytes(len(data))


if __name__ == "__main__":
    try:
        main()
    except (RulesExceeded, BrokenPipeError):
        sys.exit(1)
