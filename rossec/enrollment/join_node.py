"""A node joins: it connects to the authority of its invitation and sends its request.

A connection that breaks, or an authority that is busy, is tried again a few times, with the same
request: it gets the same answer. A refusal is not tried again.
"""

import asyncio
import secrets
from collections.abc import Callable
from typing import Final

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
RETRY_DELAY: Final = 0.5  # seconds, then twice as long each time, and up to as much again


async def join(
    code: InvitationCode, request: Callable[[str], bytes], clock: Callable[[], int]
) -> JoinedIdentity:
    """Join by `code`, and return the verified identity, which is not on the disk yet.

    `request` returns this node's CSR (DER) for a trust domain: the same one each time.

    Raises:
        JoinWaiting: not yet; the same request may be sent again.
        EnrollmentRefused: the authority refused, or the peer is not the authority.
        PeerUnreachable: no answer.
    """
    host, port = address.split(code.address, address.JOIN_PORT)
    tries, delay = 0, RETRY_DELAY
    while True:
        tries += 1
        try:
            return await _session(code, request, clock, host, port)
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


async def _session(
    code: InvitationCode,
    request: Callable[[str], bytes],
    clock: Callable[[], int],
    host: str,
    port: int,
) -> JoinedIdentity:
    core = NodeJoin(code, secrets.token_bytes(NONCE_SIZE))
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
        wire.send(writer, core.join(request(core.anchor.domain)))
        async with asyncio.timeout(_DECISION):
            core.receive(await wire.receive(reader), clock())
    finally:
        writer.close()
    return core.identity
