"""Who asks the service: the user, the process and its command line, for the audit.

The kernel says which process connected (SO_PEERCRED). Its command line is read from /proc at that
moment and is what the process itself says: a process can change it, or end and another one get its
number. It is evidence for a person who reads the audit, and decides nothing.
"""

from pathlib import Path
from typing import Final, NamedTuple

from rossec.net.host.peeruid import UnixPeer
from rossec.ros.text import printable

_MAX_READ: Final = 4096  # bytes
_MAX_SHOWN: Final = 300  # characters


class Caller(NamedTuple):
    """A process that asks, as the audit names it."""

    user: int
    process: int
    command: str

    def __str__(self) -> str:
        return f"user {self.user}, process {self.process}: {self.command}"


def caller_of(peer: UnixPeer, proc: Path = Path("/proc")) -> Caller:
    """The caller at the other end of a unix socket."""
    try:
        with (proc / str(peer.process) / "cmdline").open("rb") as file:
            data = file.read(_MAX_READ)
    except OSError:
        data = b""
    words = data.rstrip(b"\0").replace(b"\0", b" ").decode(errors="replace")
    return Caller(peer.user, peer.process, printable(words, _MAX_SHOWN) or "(unknown)")
