"""The port where nodes join: sessions with strangers, whose requests are decided elsewhere.

Runs in a process without the authority's key. A session has one deadline until its request is
there; a limited number are open at a time, in all and from one address, and few requests of one
invitation are decided at a time, so that no code and no host keeps the others out. A session that
breaks the protocol is closed and reported in one line; a stranger is told nothing but a reason. If
a request cannot be decided, the node is told to come again: it then gets the same answer.
"""

import asyncio
import logging
import secrets
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Final, TypeAlias, TypeVar

from ca.enrollment import NONCE_SIZE
from ca.enrollment.join_authority import AuthorityJoin, AuthorityJoinState, LiveIdentity
from ca.enrollment.join_claim import JoinClaim
from ca.enrollment.join_messages import JoinAnswer, NameAnswer, Refused, RefuseReason, write
from ca.enrollment.join_request import JoinRequest
from ca.errors import EnrollmentRefused, HintedError
from rossec.enrollment import wire
from rossec.enrollment.session_server import SessionServer
from rossec.net.halfopen import HalfOpen
from rossec.ros.text import printable

Admit: TypeAlias = Callable[[JoinRequest], Awaitable[JoinAnswer]]
Name: TypeAlias = Callable[[JoinClaim], Awaitable[NameAnswer]]

PATIENCE: Final = 10.0  # seconds until a session's request is there
DECISION: Final = 30.0  # seconds until it is decided
MAX_OF_INVITATION: Final = 4  # decisions at a time
_CAPS: Final = HalfOpen(per_address=32, total=256)
_BUSY: Final = Refused(RefuseReason.BUSY)
_Asked = TypeVar("_Asked", JoinRequest, JoinClaim)
_Answer = TypeVar("_Answer", JoinAnswer, NameAnswer)
_log = logging.getLogger("rossec.enrollment.join")
_S = AuthorityJoinState


async def no_names(_: JoinClaim) -> NameAnswer:
    """The answer of an authority of an earlier version to every claim."""
    return Refused(RefuseReason.REFUSED)


class JoinServer:
    """The join port of an authority.

    Args:
        identity: returns the identity of `/ca` as of now; it is renewed while this runs.
        admit: decides a request; what it raises is logged, and the node told to come again.
        on_refusal: is called with each broken session as one printable line.
        patience: seconds until a session's request is there.
        caps: of open sessions, by address and in all.
        name: finds the name for a claim; raises as `admit`.
    """

    def __init__(
        self,
        identity: Callable[[], LiveIdentity],
        admit: Admit,
        on_refusal: Callable[[str], None] = lambda _: None,
        patience: float = PATIENCE,
        caps: HalfOpen = _CAPS,
        name: Name = no_names,
    ) -> None:
        self._identity = identity
        self._admit = admit
        self._name = name
        self._on_refusal = on_refusal
        self._patience = patience
        self._server = SessionServer(self._serve, caps)
        self._turns = _Turns(MAX_OF_INVITATION)

    @property
    def port(self) -> int:
        """The port it listens on."""
        return self._server.port

    async def listen(self, host: str | None, port: int) -> None:
        """As `SessionServer.listen`."""
        await self._server.listen(host, port)

    async def close(self) -> None:
        """Stop listening, and end the open sessions."""
        await self._server.close()

    async def _serve(
        self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, address: str
    ) -> None:
        core = AuthorityJoin(self._identity(), secrets.token_bytes(NONCE_SIZE))
        try:
            await self._receive(core, reader, writer)
            if core.state is _S.NAMING:
                named = await self._decided(self._name, core.claim)
                wire.send(writer, core.name(named))
            if core.state is _S.NAMED:
                await self._receive(core, reader, writer)
            if core.state is _S.DECIDING:
                wire.send(writer, core.answer(await self._decided(self._admit, core.request)))
        except EnrollmentRefused as error:
            self._on_refusal(printable(f"{address}: {error}"))
            wire.send(writer, write(Refused(RefuseReason.REFUSED)))
        except (OSError, EOFError, TimeoutError):
            pass  # the node may connect again

    async def _receive(
        self, core: AuthorityJoin, reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        """Until there is something to decide."""
        async with asyncio.timeout(self._patience):
            while core.state not in {_S.NAMING, _S.DECIDING}:
                sent = core.receive(await wire.receive(reader))
                if sent is not None:
                    wire.send(writer, sent)

    async def _decided(
        self, decide: Callable[[_Asked], Awaitable[_Answer]], asked: _Asked
    ) -> _Answer | Refused:
        try:
            async with asyncio.timeout(DECISION), self._turns.turn(asked.invitation):
                return await decide(asked)
        except TimeoutError:
            return _BUSY
        except HintedError as error:
            _log.error("a join could not be decided: %s", printable(str(error)))
        return _BUSY


class _Turns:
    """A bounded number of decisions at a time for each invitation; the others wait in order."""

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
