"""A process that talks to strangers, beside files and programs of the same user it must not touch.

It reads its own directory and what programs need, writes nothing, and starts no process. Call this
first of all: only the calling thread and those it starts later are confined (`landlock`).
"""

import logging
import resource
import sys
import sysconfig
import threading
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Final

from rossec.host import sandbox

THREADS: Final = 4  # for names of hosts; made before new ones are forbidden
_SYSTEM: Final = (
    "/usr",
    "/lib",
    "/lib64",
    "/etc",
    "/proc/self",
    "/proc/sys",
    "/dev/urandom",
    "/run/systemd/resolve",
)
_log = logging.getLogger("rossec.host")


def confine_files(own: Sequence[Path]) -> None:
    """Let this process read what is at or below `own` and what programs need, and write nothing. Where the
    kernel cannot do that, the log says so; the limits of the service manager remain."""
    found = sysconfig.get_paths()
    libraries = {found[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    programs = {*libraries, f"{sys.base_prefix}/lib", *sys.path}
    try:
        sandbox.read_only([*own, *map(Path, _SYSTEM), *map(Path, sorted(programs))])
    except OSError as error:
        _log.warning("the network process can read the files of its user: %s", error)


def confine_processes() -> ThreadPoolExecutor:
    """Let this process start no other one, nor a thread beyond those of the executor returned."""
    ready = threading.Barrier(THREADS + 1)
    executor = ThreadPoolExecutor(THREADS)
    for _ in range(THREADS):
        executor.submit(ready.wait)
    ready.wait()
    # It counts threads too; it does not bind root.
    resource.setrlimit(resource.RLIMIT_NPROC, (0, 0))
    return executor


def lower_limits(limits: Mapping[int, int]) -> None:
    """Bound resources (RLIMIT_...) of this process, for good; none is raised above what it is."""
    for what, most in limits.items():
        _, hard = resource.getrlimit(what)
        bound = most if hard == resource.RLIM_INFINITY else min(most, hard)
        resource.setrlimit(what, (bound, bound))
