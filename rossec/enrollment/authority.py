"""The authority connects to a node: fetch its request, then deliver the offer and await the result.

Between the two a person decides, so these are two connections. A broken connection is made again,
with exactly the same offer, until the offer expires.
"""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Final

from ca.enrollment.authority import AuthorityEnrollment, AuthorityState
from ca.enrollment.messages import MAX_MESSAGE
from ca.errors import EnrollmentMessageRefused
from rossec.enrollment import address, wire
from rossec.errors import NotDelivered, PeerUnreachable
from rossec.net.aio.dial import dial

_PATIENCE: Final = 10.0  # seconds to connect, and for the request
_TRIES: Final = 5
RETRY_DELAY: Final = 0.5


async def fetch(core: AuthorityEnrollment, host: str, port: int, clock: Callable[[], int]) -> None:
    """Fetch the node's request into `core.request`.

    Raises:
        EnrollmentRefused, RequestRefused: it is not the one of the code, or invalid.
        PeerUnreachable: no answer, or not in this protocol.
    """
    try:
        async with _connection(host, port) as (reader, writer), asyncio.timeout(_PATIENCE):
            wire.send(writer, core.fetch())
            core.receive(await wire.receive(reader), clock())
    except (OSError, EOFError, TimeoutError) as error:
        raise PeerUnreachable(
            f"no node waits to be enrolled at {address.join(host, port)}",
            "is `rossec node enroll` still running there, and on the same network?",
        ) from error


async def deliver(
    core: AuthorityEnrollment,
    offer: bytes,
    host: str,
    port: int,
    clock: Callable[[], int],
    show: Callable[[str], None],
) -> None:
    """Deliver `offer`, `show` the digits, and return when the node reports that it is enrolled.

    Raises:
        EnrollmentRefused: the node refused, or there is a man in the middle.
        NotDelivered: the node closed the connection and no longer answers.
    """
    failures, state = 0, core.state
    while failures < _TRIES:
        try:
            async with _connection(host, port) as (reader, writer):
                wire.send(writer, offer)
                await _listen(core, reader, clock, show)
                return
        except (OSError, EOFError, TimeoutError, EnrollmentMessageRefused):
            core.tick(clock())
            failures, state = (failures + 1 if core.state is state else 0), core.state
            await asyncio.sleep(RETRY_DELAY)
    raise NotDelivered(
        "the node closed the connection before it reported that it is enrolled",
        f"check there: rossec node show {core.request.name}",
    )


async def _listen(
    core: AuthorityEnrollment,
    reader: asyncio.StreamReader,
    clock: Callable[[], int],
    show: Callable[[str], None],
) -> None:
    shown = core.digits
    while core.state is not AuthorityState.ENROLLED:
        async with asyncio.timeout(max(1, core.deadline - clock() + 1)):
            data = await wire.receive(reader)
        core.receive(data, clock())
        if core.digits != shown:
            shown = core.digits
            show(shown)


@asynccontextmanager
async def _connection(
    host: str, port: int
) -> AsyncIterator[tuple[asyncio.StreamReader, asyncio.StreamWriter]]:
    sock = await dial(host, port, _PATIENCE)
    try:
        reader, writer = await asyncio.open_connection(sock=sock, limit=MAX_MESSAGE)
    except BaseException:
        sock.close()
        raise
    try:
        yield reader, writer
    finally:
        writer.close()
