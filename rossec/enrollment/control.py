"""How `rossec node confirm` reaches the waiting `rossec node enroll`: a socket in its directory.

Only the same user (or root) may use it: the kernel gives the user of the caller. The digits are not
secret, but confirming them activates a trust anchor, so this never goes over the network. The
socket is named through /proc: the path of a Unix socket has at most 107 octets, a directory's may
have more.
"""

import asyncio
import json
import os
import socket
import struct
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final, TypeAlias

from ca.errors import HintedError
from rossec.errors import ConfigurationError

Answer: TypeAlias = dict[str, str]

_NAME: Final = "enrolling.sock"
_LIMIT: Final = 4096
_PATIENCE: Final = 30.0
_CREDENTIALS: Final = struct.Struct("3i")  # pid, uid, gid: unix(7), SO_PEERCRED


async def serve(directory: Path, answer: Callable[[Answer], Answer]) -> asyncio.Server:
    """Answer requests on the socket in `directory`.

    Raises:
        ConfigurationError: another process does so already.
    """

    async def call(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            if _is_ours(writer.get_extra_info("socket")):
                async with asyncio.timeout(_PATIENCE):
                    request = _request(await reader.readline())
                writer.write(json.dumps(_call(answer, request)).encode() + b"\n")
        except (OSError, ValueError, TimeoutError):
            pass  # a malformed request gets no answer
        finally:
            writer.close()

    other = _connect(directory)
    if other is not None:
        other.close()
        raise ConfigurationError(
            "an enrollment of this node is waiting already", "finish or stop that one first"
        )
    with _socket_path(directory) as path:
        return await asyncio.start_unix_server(call, path, limit=_LIMIT)


def remove(directory: Path) -> None:
    """Remove the socket."""
    (directory / _NAME).unlink(missing_ok=True)


def ask(directory: Path, request: Answer) -> Answer:
    """Ask the waiting process.

    Raises:
        ConfigurationError: there is none, or it refused; then with its message.
    """
    sock = _connect(directory)
    if sock is None:
        raise ConfigurationError(
            "no enrollment of this node is waiting", "first: rossec node enroll NAME"
        )
    with sock:
        line = _exchange(sock, json.dumps(request).encode() + b"\n")
    if not line:
        raise ConfigurationError("the waiting enrollment has just ended", "see its last message")
    answer: Answer = json.loads(line)
    if "error" in answer:
        raise ConfigurationError(answer["error"], answer.get("hint", ""))
    return answer


def _exchange(sock: socket.socket, request: bytes) -> bytes:
    """The answer, one line; empty when the other side has closed."""
    sock.settimeout(_PATIENCE)
    with suppress(OSError), sock.makefile("rb") as stream:
        sock.sendall(request)
        return stream.readline(_LIMIT)
    return b""


def _request(line: bytes) -> Answer:
    found = json.loads(line)
    if not isinstance(found, dict):
        raise ValueError("not a request")  # noqa: TRY004 - as json says it
    return found


def _call(answer: Callable[[Answer], Answer], request: Answer) -> Answer:
    try:
        return answer(request)
    except HintedError as error:
        return {"error": str(error), "hint": error.hint}


def _is_ours(sock: socket.socket) -> bool:
    raw = sock.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    _, user, _ = _CREDENTIALS.unpack(raw)
    return user in {0, os.getuid()}


def _connect(directory: Path) -> socket.socket | None:
    """A connection to the waiting process, or None: the socket of a process that has exited."""
    sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        with _socket_path(directory) as path:
            sock.connect(path)
    except (FileNotFoundError, ConnectionRefusedError):
        sock.close()
        return None
    return sock


@contextmanager
def _socket_path(directory: Path) -> Iterator[str]:
    descriptor = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        yield f"/proc/self/fd/{descriptor}/{_NAME}"
    finally:
        os.close(descriptor)
