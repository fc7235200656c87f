"""The administrator's local port of a master or a relay, and limits of the process. A shell.

The port is a Unix socket in its own directory (0600), and the kernel reports the user of the peer:
only the user who runs it, and root, are admitted. A master's is off unless enabled. A connection is
one request and one answer, each a line of JSON. No command changes a right.
"""

import asyncio
import json
import logging
import os
import resource
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ca.bounded import Newest
from grants.limits import TokenBucket
from rossec.errors import ConfigurationError, PeerUserRefused
from rossec.host.audit import LEFT_OUT
from rossec.host.local_sockets import listen_at, raw_socket, require_user
from rossec.peer_limits import subject

DESCRIPTORS: Final = 65536  # each node takes two, and a shell's soft limit is often 1024


def raise_descriptor_limit() -> None:
    """Raise the soft limit to `DESCRIPTORS`, or to the hard limit where that is lower."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    missing = DESCRIPTORS if hard == resource.RLIM_INFINITY else min(hard, DESCRIPTORS)
    if soft != resource.RLIM_INFINITY and soft < missing:
        resource.setrlimit(resource.RLIMIT_NOFILE, (missing, hard))


DENIALS: Final = "rossec.audit.denials"
MAX_NODES: Final = 4096


@dataclass
class NodeBudget:
    limit: TokenBucket = field(default_factory=lambda: TokenBucket(10, 200))
    reserved: TokenBucket = field(default_factory=lambda: TokenBucket(0.1, 10))
    left_out: int = 0


class DenialRateLimit(logging.Filter):
    """A node that is denied a thousand times a second neither fills the disk nor hides other lines."""

    # There is a bucket for each node and one for all. Several nodes together could empty the common one, so
    # each also has a small bucket in reserve. Lines of administrators are never limited: those that nodes
    # cause have their own logger, a child of the audit's.
    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        super().__init__()
        self._clock = clock
        self._common = TokenBucket(50, 1000)
        self._nodes: Newest[str, NodeBudget] = Newest(MAX_NODES)

    def filter(self, record: logging.LogRecord) -> bool:
        # Whether the line is written; if so, it records how many before it were not.
        now = self._clock()
        node = subject(record)
        budget = self._nodes[node] = self._nodes.get(node) or NodeBudget()  # the newest
        common = self._common if self._common.refill(now) >= 1 else budget.reserved
        if not (budget.limit.refill(now) >= 1 and common.refill(now) >= 1):
            budget.left_out += 1
            return False
        budget.limit.tokens -= 1
        common.tokens -= 1
        if budget.left_out:
            setattr(record, LEFT_OUT, budget.left_out)
            budget.left_out = 0
        return True


@contextmanager
def denials_limited() -> Iterator[None]:
    """Meanwhile one caller cannot fill the log with its denials."""
    limit, log = DenialRateLimit(), logging.getLogger(DENIALS)
    log.addFilter(limit)
    try:
        yield
    finally:
        log.removeFilter(limit)


DEADLINE: Final = 5.0
_MAX_LINE: Final = 1024
_HINTS: Final = {"master": "is it running? rossec master --admin, or `admin: true` in its configuration"}
_audit = logging.getLogger("rossec.audit")
_denials = logging.getLogger(DENIALS)

Commands = Mapping[str, Callable[[], Mapping[str, Any]]]


class AdminPort:
    """Listens at `path` for the names of `commands`."""

    def __init__(self, path: Path, commands: Commands) -> None:
        self._path = path
        self._commands = commands
        self._server: asyncio.Server | None = None

    async def start(self) -> None:
        if self._path.exists():
            with socket.socket(socket.AF_UNIX) as probe:
                if probe.connect_ex(str(self._path)) == 0:
                    raise ConfigurationError(f"another program listens at {self._path}")
            self._path.unlink()  # of a master that was killed
        sock = listen_at(self._path)
        self._server = await asyncio.start_unix_server(self._handle, sock=sock, limit=_MAX_LINE)

    async def close(self) -> None:
        if self._server is not None:
            self._server.close()
            self._path.unlink(missing_ok=True)

    async def _handle(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            with suppress(TimeoutError, OSError, ValueError, RecursionError, asyncio.IncompleteReadError):
                async with asyncio.timeout(DEADLINE):
                    await self._answer(reader, writer)
        finally:
            writer.close()

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        sock = writer.get_extra_info("socket")
        try:
            user = require_user(raw_socket(sock), {os.geteuid(), 0})
        except (PeerUserRefused, OSError) as error:
            _denials.warning("refused at the administrator's port: %s", error)
            return
        command = json.loads(await reader.readuntil(b"\n"))
        action = self._commands.get(command) if isinstance(command, str) else None
        if action is None:
            answer: Mapping[str, Any] = {"error": "unknown command"}
        else:
            _audit.info("user %d asks for %s", user, command)
            answer = action()
        writer.write(json.dumps(answer).encode() + b"\n")
        await writer.drain()


def send_command(path: Path, command: str, what: str = "master") -> dict[str, Any]:
    """Send a command to the master, or relay, that listens at `path`."""
    hint = _HINTS.get(what, f"is it running? rossec {what}")
    try:
        with socket.socket(socket.AF_UNIX) as sock:
            sock.settimeout(DEADLINE)
            sock.connect(str(path))
            sock.sendall(json.dumps(command).encode() + b"\n")
            with sock.makefile("rb") as file:
                answer = json.loads(file.readline(1 << 20) or b"null")
    except (OSError, ValueError) as error:
        reason = (isinstance(error, OSError) and error.strerror) or error
        raise ConfigurationError(f"the {what} does not answer at {path}: {reason}", hint) from error
    if not isinstance(answer, dict) or "error" in answer:
        raise ConfigurationError(f"the {what} refused", hint)
    return answer
