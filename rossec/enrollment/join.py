"""Joining by an invitation: the port of the authority, whose requests are decided elsewhere, and the node
that connects.

The port runs in a process without the authority's key. A limited number of sessions are open at a time, in
all and from one address. A session that breaks the protocol is closed and reported in one line; a stranger is
told nothing but a reason. A connection that breaks, or an authority that is busy, is tried again a few times,
with the same request; a refusal is not.
"""

import asyncio
import logging
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Final, TypeAlias, TypeVar

from ca.enrollment import NONCE_SIZE
from ca.enrollment.invitation import InvitationCode, JoinClaim, JoinRequest
from ca.enrollment.join import (
    AuthorityJoin,
    AuthorityJoinState,
    JoinAnswer,
    JoinedIdentity,
    LiveIdentity,
    NameAnswer,
    NodeJoin,
    RefusedMessage,
    RefuseReason,
    write,
)
from ca.errors import EnrollmentRefused, HintedError, JoinBusy
from rossec.enrollment import sessions
from rossec.enrollment.sessions import SessionServer
from rossec.errors import PeerUnreachable
from rossec.host import addresses
from rossec.net.limits import HalfOpenLimits
from rossec.peer_limits import printable

Admit: TypeAlias = Callable[[JoinRequest], Awaitable[JoinAnswer]]
Name: TypeAlias = Callable[[JoinClaim], Awaitable[NameAnswer]]

REQUEST_PATIENCE: Final = 10.0  # seconds until a session's request is there
DECISION: Final = 30.0  # seconds until it is decided
MAX_OF_INVITATION: Final = 4  # decisions at a time
CONNECT_PATIENCE: Final = 10.0  # seconds to connect, and for the authority to show itself
RETRY_DELAY: Final = 0.5  # seconds, then twice as long each time, and up to as much again
_DECISION: Final = 45.0  # seconds for the answer
_TRIES: Final = 5
_CAPS: Final = HalfOpenLimits(per_address=32, total=256)
_BUSY: Final = RefusedMessage(RefuseReason.BUSY)
_T = TypeVar("_T")
_Asked = TypeVar("_Asked", JoinRequest, JoinClaim)
_Answer = TypeVar("_Answer", JoinAnswer, NameAnswer)
_log = logging.getLogger("rossec.enrollment.join")
_S = AuthorityJoinState


async def no_names(_: JoinClaim) -> NameAnswer:
    return RefusedMessage(RefuseReason.REFUSED)


class JoinServer(SessionServer):
    """The join port: one session for each node, from hello to answer."""

    def __init__(
        self,
        identity: Callable[[], LiveIdentity],  # of `/ca` as of now; it is renewed while this runs
        admit: Admit,  # decides a request; what it raises is logged, and the node told to come again
        on_refusal: Callable[[str], None] = lambda _: None,  # called with each broken session as one line
        patience: float = REQUEST_PATIENCE,
        caps: HalfOpenLimits = _CAPS,
        name: Name = no_names,  # finds the name for a claim; raises as `admit`
    ) -> None:
        self._identity = identity
        self._admit = admit
        self._name = name
        self._on_refusal = on_refusal
        self._patience = patience
        super().__init__(self._run, caps)
        self._turns = _Turns(MAX_OF_INVITATION)

    async def _run(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str) -> None:
        core = AuthorityJoin(self._identity(), secrets.token_bytes(NONCE_SIZE))
        try:
            await self._receive(core, reader, writer)
            if core.state is _S.NAMING:
                named = await self._decided(self._name, core.claim)
                sessions.send(writer, core.name(named))
            if core.state is _S.NAMED:
                await self._receive(core, reader, writer)
            if core.state is _S.DECIDING:
                sessions.send(writer, core.answer(await self._decided(self._admit, core.request)))
        except EnrollmentRefused as error:
            self._on_refusal(printable(f"{address}: {error}"))
            sessions.send(writer, write(RefusedMessage(RefuseReason.REFUSED)))
        except (OSError, EOFError, TimeoutError):
            pass  # the node may connect again

    async def _receive(
        self, core: AuthorityJoin, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        # One deadline for all of it: octet by octet, a stranger would hold a place for hours.
        async with asyncio.timeout(self._patience):
            while core.state not in {_S.NAMING, _S.DECIDING}:
                sent = core.receive(await sessions.receive(reader))
                if sent is not None:
                    sessions.send(writer, sent)

    async def _decided(
        self, decide: Callable[[_Asked], Awaitable[_Answer]], asked: _Asked
    ) -> _Answer | RefusedMessage:
        # Few of one invitation at a time, so that no code keeps the others out. What cannot be decided is
        # BUSY: the node comes again, and gets the same answer to the same request.
        try:
            async with asyncio.timeout(DECISION), self._turns.turn(asked.invitation):
                return await decide(asked)
        except TimeoutError:
            return _BUSY
        except HintedError as error:
            _log.error("a join could not be decided: %s", printable(str(error)))
        return _BUSY


class _Turns:
    def __init__(self, most: int) -> None:
        self._most = most
        self._waiting: dict[bytes, tuple[asyncio.Semaphore, int]] = {}

    @asynccontextmanager
    async def turn(self, invitation: bytes) -> AsyncIterator[None]:
        fresh = asyncio.Semaphore(self._most), 0
        semaphore, users = self._waiting.get(invitation, fresh)
        self._waiting[invitation] = semaphore, users + 1
        try:
            async with semaphore:
                yield
        finally:
            semaphore, users = self._waiting.pop(invitation)
            if users > 1:
                self._waiting[invitation] = semaphore, users - 1


async def ask_name(code: InvitationCode, metadata: bytes, clock: Callable[[], int]) -> str:
    """The name that the authority's rules give for `metadata`: nothing is made or recorded."""

    async def session() -> str:
        core = NodeJoin(code, secrets.token_bytes(NONCE_SIZE))
        await _asked(code, core, clock, lambda: core.claim(metadata))
        return core.name

    return await _tried(code, session)


async def join(
    code: InvitationCode, request: Callable[[str], bytes], clock: Callable[[], int], metadata: bytes = b""
) -> JoinedIdentity:
    """Join by `code`, and return the verified identity, which is not on the disk yet."""
    # `request` returns this node's CSR (DER) for a trust domain: the same one each time. With `metadata` the
    # authority issues only the name that its rules give for them (`ask_name`).

    async def session() -> JoinedIdentity:
        core = NodeJoin(code, secrets.token_bytes(NONCE_SIZE))
        await _asked(code, core, clock, lambda: core.join(request(core.anchor.domain), metadata))
        return core.identity

    return await _tried(code, session)


async def _tried(code: InvitationCode, session: Callable[[], Awaitable[_T]]) -> _T:
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
        # Spread: a fleet that was switched on at once does not come back at once.
        await asyncio.sleep(delay * (1 + secrets.randbelow(1000) / 1000))
        delay *= 2


async def _asked(
    code: InvitationCode, core: NodeJoin, clock: Callable[[], int], message: Callable[[], bytes]
) -> None:
    host, port = addresses.split(code.address, addresses.JOIN_PORT)
    async with sessions.connected(host, port, CONNECT_PATIENCE) as (reader, writer):
        sessions.send(writer, core.hello())
        async with asyncio.timeout(CONNECT_PATIENCE):
            core.receive(await sessions.receive(reader), clock())
        sessions.send(writer, message())  # once the authority has shown itself
        async with asyncio.timeout(_DECISION):
            core.receive(await sessions.receive(reader), clock())
