"""Which processes may not use `service.sock`: whoever showed itself to be the console's pages.

The web process is confined as the network face is: it can start no other process. So one that was
taken over cannot ask for the key's signature, whether it came to the console's socket first (it is
remembered as long as it lives) or not (a process that may start no other one is no command of a
person; it cannot take that back). A number of a process that ended is given to another one, so its
start is remembered too, where the kernel shows it.
"""

import threading
from pathlib import Path
from typing import Final

from rossec.errors import PeerUserRefused
from rossec.net.host.peeruid import UnixPeer

_START: Final = 19  # of the fields after the command's name, proc(5): starttime
_LIMIT: Final = b"Max processes"
_REFUSED: Final = "a process of the console's pages may not use the service's socket"


class ConsolePeers:
    """The processes that connected to the console's socket; threads may share it."""

    def __init__(self, proc: Path = Path("/proc")) -> None:
        self._proc = proc
        self._lock = threading.Lock()
        self._known: dict[int, bytes | None] = {}  # when it started, by its number

    def remember(self, peer: UnixPeer) -> None:
        """A process came to the console's socket."""
        started = self._started(peer.process)
        with self._lock:
            for process in [each for each in self._known if self._is_gone(each)]:
                del self._known[process]
            self._known[peer.process] = started

    def refuse(self, peer: UnixPeer) -> None:
        """Raise for one of them, or another that is confined in the same way.

        Raises:
            PeerUserRefused: it may not ask for the key.
        """
        with self._lock:
            is_known = peer.process in self._known and not self._is_gone(peer.process)
        if is_known or self._is_confined(peer.process):
            raise PeerUserRefused(_REFUSED)

    def _is_gone(self, process: int) -> bool:
        """Whether the process that was remembered under this number has surely ended."""
        remembered, now = self._known[process], self._started(process)
        if now is None:
            return not (self._proc / str(process)).exists() and (self._proc / "self").exists()
        return remembered is not None and remembered != now

    def _started(self, process: int) -> bytes | None:
        try:
            stat = (self._proc / str(process) / "stat").read_bytes()
        except OSError:
            return None
        fields = stat.rpartition(b")")[2].split()  # its name may have spaces and parentheses
        return fields[_START] if len(fields) > _START else None

    def _is_confined(self, process: int) -> bool:
        """Whether it may have no other process: `RLIMIT_NPROC` is 0."""
        try:
            limits = (self._proc / str(process) / "limits").read_bytes()
        except OSError:
            return False
        rows = [line for line in limits.splitlines() if line.startswith(_LIMIT)]
        return any(row.removeprefix(_LIMIT).split()[:2] == [b"0", b"0"] for row in rows)
