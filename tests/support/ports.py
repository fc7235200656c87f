"""Ports for programs that are told theirs, and bind it a moment later."""

import errno
import os
import socket
from pathlib import Path
from secrets import SystemRandom
from typing import Final

_EPHEMERAL: Final = Path("/proc/sys/net/ipv4/ip_local_port_range")
_BLOCK: Final = 50
_BLOCKS: Final = range(20_000, 32_000, _BLOCK)
_WILDCARDS: Final = ((socket.AF_INET, "0.0.0.0"), (socket.AF_INET6, "::"))

_left: list[int] = []  # of the block that this process has
os.register_at_fork(after_in_child=_left.clear)


def free_port() -> int:
    """A port that nobody has, and that no other test is given: never the same one twice.

    It is not ephemeral. One that the kernel chose (port 0) and that was released could be chosen
    again before the program has it, for any connection of another test.
    """
    while True:
        if not _left:
            _left.extend(_take_block())
        port = _left.pop()
        if _is_free(port):
            return port


def _take_block() -> range:
    """Ports that are this process's own until it ends.

    An abstract socket holds them: as ports it is one network namespace's, and it leaves no file.
    """
    low, high = (int(word) for word in _EPHEMERAL.read_text().split())
    outside = [first for first in _BLOCKS if first + _BLOCK <= low or first > high]
    blocks = outside or [*_BLOCKS]
    for first in SystemRandom().sample(blocks, len(blocks)):
        claim = socket.socket(socket.AF_UNIX)
        try:
            claim.bind(f"\0rossec-tests-ports-{first}")
        except OSError as error:
            claim.close()
            if error.errno != errno.EADDRINUSE:
                raise
        else:
            claim.detach()  # stays open
            return range(first, first + _BLOCK)
    raise AssertionError("other processes hold all ports for tests")


def _is_free(port: int) -> bool:
    """Whether it can be bound at every address; not while an earlier connection lingers there."""
    for family, wildcard in _WILDCARDS:
        try:
            with socket.socket(family) as sock:
                if family == socket.AF_INET6:
                    sock.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
                sock.bind((wildcard, port))
        except OSError as error:
            if error.errno == errno.EADDRINUSE:
                return False
            if error.errno not in (errno.EAFNOSUPPORT, errno.EADDRNOTAVAIL):  # without IPv6
                raise
    return True
