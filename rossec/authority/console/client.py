"""The console's side: asks the authority's service over `console.sock`. A shell.

A few connections are kept, one request at a time on each.
"""

import asyncio
import os
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, nullcontext
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from ca.encoding import Value
from rossec.authority.console import messages
from rossec.authority.keyservice import messages as frames
from rossec.authority.keyservice.messages import ServiceRequest
from rossec.errors import KeyServiceFailed, PeerUserRefused
from rossec.host import local_sockets, workers

CONNECTIONS: Final = 4
STRANGERS: Final = 1  # of them are used at a time for what anybody on the network may ask
TIMEOUT: Final = 60.0  # seconds for an answer: the master is called within 30
_HINT: Final = "see: rossec ca status; start it with: rossec ca serve"


class _Connection(NamedTuple):
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter


class ConsoleClient(messages.Operations):
    """The service whose console's socket is at `path`; connected when it is needed.

    Every method raises the service's refusal (`HintedError`), or `KeyServiceFailed` if it does not
    answer.
    """

    def __init__(self, path: Path, timeout: float = TIMEOUT) -> None:
        self._path = path
        self._timeout = timeout
        self._free: list[_Connection] = []
        self._places = asyncio.Semaphore(CONNECTIONS)
        self._strangers = asyncio.Semaphore(STRANGERS)

    async def close(self) -> None:
        while self._free:
            self._free.pop().writer.transport.abort()
        await asyncio.sleep(0)

    async def ask(self, operation: str, *arguments: Value) -> Value:
        data = frames.write_request(ServiceRequest(operation, arguments))
        # Strangers have one of the places (`login-flood`): the others remain for who is logged in.
        lane = self._strangers if messages.OPERATIONS[operation].of_strangers else nullcontext()
        async with lane, self._places:
            try:
                async with asyncio.timeout(self._timeout):
                    try:
                        return await self._exchange(data)
                    except (ConnectionError, asyncio.IncompleteReadError):
                        # Once more: services are restarted, and drop those that are idle. That is safe for
                        # every operation of the table: a code, a challenge or a statement is used up by the
                        # first, and what was taken away stays so.
                        await self.close()
                        return await self._exchange(data)
            except (FileNotFoundError, ConnectionRefusedError) as error:
                raise KeyServiceFailed("the authority's service does not run", _HINT) from error
            except (OSError, TimeoutError, asyncio.IncompleteReadError) as error:
                raise KeyServiceFailed("the authority's service does not answer", _HINT) from error

    async def _exchange(self, data: bytes) -> Value:
        async with self._connection() as (reader, writer):
            writer.write(data)
            await writer.drain()
            body = await workers.read_frame(reader, partial(frames.frame_size, limit=messages.MAX_ANSWER))
        return frames.read_answer(body, messages.MAX_ANSWER)

    @asynccontextmanager
    async def _connection(self) -> AsyncIterator[_Connection]:
        connection = self._free.pop() if self._free else await _connect(self._path)
        try:
            yield connection
        except BaseException:
            connection.writer.transport.abort()
            raise
        self._free.append(connection)


async def _connect(path: Path) -> _Connection:
    # Whoever listens is the own user, or the owner of the socket's directory, which nobody else can write.
    allowed = {os.geteuid()}
    directory = path.parent.stat()
    if not directory.st_mode & 0o022:
        allowed.add(directory.st_uid)
    reader, writer = await asyncio.open_unix_connection(path)
    try:
        local_sockets.require_user(local_sockets.raw_socket(writer.get_extra_info("socket")), allowed)
    except PeerUserRefused as error:
        writer.transport.abort()
        raise KeyServiceFailed(f"another user listens at {path}", "find out who did that") from error
    return _Connection(reader, writer)
