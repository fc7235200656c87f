"""A node joins: it connects to the authority of its invitation and sends its request.

A connection that breaks, or an authority that is busy, is tried again a few times, with the same
request: it gets the same answer. A refusal is not tried again.
"""

import asyncio
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Final, NamedTuple, TypeVar

from ca.enrollment import NONCE_SIZE
from ca.enrollment.invitation import InvitationCode
from ca.enrollment.join_node import JoinedIdentity, NodeJoin
from ca.enrollment.messages import MAX_MESSAGE
from ca.errors import JoinBusy
from rossec.enrollment import address, wire
from rossec.errors import PeerUnreachable
from rossec.net.aio.dial import dial

PATIENCE: Final = 10.0  # seconds to connect, and for the authority to show itself
_DECISION: Final = 45.0  # seconds for the answer
_TRIES: Final = 5
_T = TypeVar("_T")
RETRY_DELAY: Final = 0.5  # seconds, then twice as long each time, and up to as much again


async def ask_name(code: InvitationCode, metadata: bytes, clock: Callable[[], int]) -> str:
    """The name that the authority's rules give for `metadata`: nothing is made or recorded.

    Raises:
        EnrollmentRefused: the authority refuses or gives no names, or the peer is not it.
        PeerUnreachable: no answer.
    """

    async def session() -> str:
        core = NodeJoin(code, secrets.token_bytes(NONCE_SIZE))
        async with _welcomed(code, core, clock) as connection:
            await connection.ask(core, core.claim(metadata), clock)
        return core.name

    return await _tried(code, session)


async def join(
    code: InvitationCode,
    request: Callable[[str], bytes],
    clock: Callable[[], int],
    metadata: bytes = b"",
) -> JoinedIdentity:
    """Join by `code`, and return the verified identity, which is not on the disk yet.

    `request` returns this node's CSR (DER) for a trust domain: the same one each time. With
    `metadata` the authority issues only the name that its rules give for them (`ask_name`).

    Raises:
        JoinWaiting: not yet; the same request may be sent again.
        EnrollmentRefused: the authority refused, or the peer is not the authority.
        PeerUnreachable: no answer.
    """

    async def session() -> JoinedIdentity:
        core = NodeJoin(code, secrets.token_bytes(NONCE_SIZE))
        async with _welcomed(code, core, clock) as connection:
            csr = request(core.anchor.domain)
            await connection.ask(core, core.join(csr, metadata), clock)
        return core.identity

    return await _tried(code, session)


async def _tried(code: InvitationCode, session: Callable[[], Awaitable[_T]]) -> _T:
    """The outcome of a session, tried again where that may help."""
    tries, delay = 0, RETRY_DELAY
    while True:
        tries += 1
        try:
            return await session()
        except JoinBusy:
            if tries == _TRIES:
                raise
        except (OSError, EOFError, TimeoutError) as error:
            if tries == _TRIES or isinstance(error, ConnectionRefusedError):
                raise PeerUnreachable(
                    f"no authority answers at {code.address}",
                    "is `rossec ca serve` running there, and on the same network?",
                ) from error
        await asyncio.sleep(delay * (1 + secrets.randbelow(1000) / 1000))
        delay *= 2


class _Connection(NamedTuple):
    reader: asyncio.StreamReader
    writer: asyncio.StreamWriter

    async def ask(self, core: NodeJoin, message: bytes, clock: Callable[[], int]) -> None:
        """Send a message, and let the core take the answer."""
        wire.send(self.writer, message)
        async with asyncio.timeout(_DECISION):
            core.receive(await wire.receive(self.reader), clock())


@asynccontextmanager
async def _welcomed(
    code: InvitationCode, core: NodeJoin, clock: Callable[[], int]
) -> AsyncIterator[_Connection]:
    """A connection to the authority, which has shown itself; closed afterwards."""
    host, port = address.split(code.address, address.JOIN_PORT)
    sock = await dial(host, port, PATIENCE)
    try:
        reader, writer = await asyncio.open_connection(sock=sock, limit=MAX_MESSAGE)
    except BaseException:
        sock.close()
        raise
    try:
        wire.send(writer, core.hello())
        async with asyncio.timeout(PATIENCE):
            core.receive(await wire.receive(reader), clock())
        yield _Connection(reader, writer)
    finally:
        writer.close()
