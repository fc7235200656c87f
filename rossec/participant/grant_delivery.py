"""Grants that the authority deposited at the master for this node: fetched, verified, stored.

They are fetched in each session, and while it lasts a call of its own connection waits for more
(`rossec.watchGrants`). The master only carries them: what is not signed by the authority, for this
domain and for this node's key, or is revoked, is dropped. A master without these calls, of an older
version, is used without them.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from secrets import SystemRandom
from typing import Final

from ca.certificates import Identity, TrustAnchor
from ca.domains.aliases import shown
from ca.domains.standing import Standing
from ca.errors import HintedError
from grants import document
from grants.errors import GrantError, GrantExpired, GrantNotHeld
from grants.model import Grant
from rossec import clock
from rossec.errors import AnswerMalformed, AnswerRefused, ConfigurationError
from rossec.net.aio import SecureStream
from rossec.net.rpc.client import RpcClient
from rossec.participant.access_interfaces import HeldGrants
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.grant_renewal import MasterCall
from rossec.participant.retry import Retry
from rossec.ros.names import MASTER
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

FETCH: Final = "rossec.fetchGrants"
WATCH: Final = "rossec.watchGrants"
MAX_KNOWN: Final = 256  # ids in one call: the limit of the master
MAX_ANSWERS: Final = 64  # to one fetch; a master has at most 64 grants for one key
WATCH_DEADLINE: Final = 90.0  # seconds; the master answers after 60
SHORTEST: Final = 1.0  # seconds an answer without a new grant takes
CHECK_PERIOD: Final = 0.25  # seconds between looks whether the session is open

_log = logging.getLogger("rossec.node")


class GrantDelivery:
    """Takes what the master has for one node.

    Args:
        standing: the authorities that may have signed one, and what they have revoked.
        holder: the thumbprint of the node's key.
        access, directory: where the grants are held, and stored by `save`.

    Attributes:
        supported: set while the master of the session knows the calls.
        taken: how many grants were new so far.
    """

    def __init__(
        self,
        standing: Standing,
        holder: bytes,
        access: HeldGrants,
        directory: GrantDirectory,
    ) -> None:
        self._standing = standing
        self._holder = holder
        self._access = access
        self._directory = directory
        self._received: dict[bytes, None] = {}  # ids, valid or not: not again in this session
        self._new: list[bytes] = []
        self._unsaved: list[tuple[bytes, bytes]] = []
        self._arrived = asyncio.Event()
        self.supported = asyncio.Event()
        self.taken = 0

    async def fetch(self, call: MasterCall) -> None:
        """Fetch everything, at the beginning of a session; what was refused is judged again.

        A master that forged a grant, or a clock that was wrong, keeps it away no longer than that.

        Raises:
            RossecError: the master is out of reach, or sends a malformed answer.
        """
        self._received.clear()
        try:
            for _ in range(MAX_ANSWERS):
                if not self.take(await call(FETCH, self.known())):
                    break
        except (Fault, AnswerRefused):
            self.supported.clear()
        else:
            self.supported.set()

    def known(self) -> bytes:
        """The ids of the grants this node needs no more, one after the other."""
        ids = dict.fromkeys(reversed(self._received))
        ids |= dict.fromkeys(held.grant.id for held in self._access.held_grants())
        return b"".join(list(ids)[:MAX_KNOWN])

    def take(self, answer: object) -> bool:
        """Hold the valid grants of an answer; returns whether more follow.

        Raises:
            AnswerMalformed: not `{"grants": [bytes], "more": bool}`.
        """
        match answer:
            case {"grants": list() as grants, "more": bool() as more} if not more or grants:
                for data in grants:
                    self._take(data)
                return more
            case _:
                raise AnswerMalformed("the master's answer is not a list of grants")

    def take_new(self) -> list[bytes]:
        """The grants that are new since the last call; they are held."""
        new, self._new = self._new, []
        self._arrived.clear()
        return new

    async def save(self) -> None:
        """Store what was taken: after it is in use, and in a thread, since a disk may be slow."""
        unsaved, self._unsaved = self._unsaved, []
        for grant_id, data in unsaved:
            await asyncio.to_thread(self._directory.save, grant_id, data)

    async def wait(self, longest: float) -> None:
        """Return when a grant is new, or after `longest` seconds."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(longest):
                await self._arrived.wait()

    def _take(self, data: object) -> None:
        if not isinstance(data, bytes):
            raise AnswerMalformed("the master sends a grant that is not bytes")
        try:
            grant_id = document.grant_id(data)
            self._receive(grant_id)
            self._check(data, clock.now())
        except HintedError as error:
            _log.warning("a grant that the master delivers is refused: %s", printable(error))
            return
        if self._directory.hold(data):
            self._new.append(data)
            self._unsaved.append((grant_id, data))
            self.taken += 1
            self._arrived.set()

    def _receive(self, grant_id: bytes) -> None:
        """Remember an id, the newest last."""
        self._received.pop(grant_id, None)
        self._received[grant_id] = None
        if len(self._received) > MAX_KNOWN:
            del self._received[next(iter(self._received))]

    def _check(self, data: bytes, now: int) -> Grant:
        """Verify a grant; one that is not valid yet, or may be renewed, is taken too.

        Raises:
            GrantError: forged, malformed, of another key, or at its end for good.
        """
        anchor = self._anchor_of(document.peek(data).domain)
        grant = document.verify(data, anchor.public_key, domain=anchor.domain)
        if grant.holder != self._holder:
            raise GrantNotHeld("the grant is bound to another key", f"it is for {grant.subject}")
        if now >= grant.cap:
            raise GrantExpired(f"the grant {grant.short_id} has expired")
        if grant.id in self._standing.own.entries | self._standing.revoked(grant.domain):
            raise GrantError(f"the grant {grant.short_id} is revoked")
        return grant

    def _anchor_of(self, domain: str) -> TrustAnchor:
        """Whose key a grant must be signed by: its domain only selects it."""
        listed = self._standing.anchors.listed_domain(domain)
        return self._standing.anchors.own if listed is None else listed.anchor


class GrantWatch:
    """Waits at the master for grants, on a connection of its own, while the session is open.

    Args:
        name: the node's own name, the `caller_id` of every call.
        dial: opens a secure stream to the master.
        is_open: whether the session is open.
        master: the certified name of the node's own master.
    """

    def __init__(
        self,
        name: str,
        delivery: GrantDelivery,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        is_open: Callable[[], bool],
        master: str = MASTER,
    ) -> None:
        self._name = name
        self._delivery = delivery
        self._dial = dial
        self._is_open = is_open
        self._master = master
        self._client: RpcClient | None = None

    async def session_opened(self) -> None:
        """End a connection of an earlier session, which may be dead without a sign."""
        await self._disconnect()

    async def run(self) -> None:
        """Watch until cancelled."""
        retry = Retry(SystemRandom().random)
        try:
            while True:
                await self._delivery.supported.wait()
                if not self._is_open():
                    await asyncio.sleep(CHECK_PERIOD)
                    continue
                try:
                    await self._watch(retry)
                except (HintedError, OSError, TimeoutError, Fault) as error:
                    _log.debug("%s: waits for grants again: %s", self._name, printable(error))
                    await self._disconnect()
                    await asyncio.sleep(retry.pause(asyncio.get_running_loop().time()))
        finally:
            await self._disconnect()

    async def _watch(self, retry: Retry) -> None:
        stream = await self._dial()
        if stream.peer.name != self._master:
            stream.abort("not the master")
            raise ConfigurationError(f"{shown(stream.peer.name)} answers at the master's address")
        client = self._client = RpcClient(stream, deadline=WATCH_DEADLINE)
        while True:
            began, before = asyncio.get_running_loop().time(), self._delivery.taken
            self._delivery.take(await client.ask(WATCH, self._name, self._delivery.known()))
            retry.succeeded()
            took = asyncio.get_running_loop().time() - began
            if self._delivery.taken == before and took < SHORTEST:
                await asyncio.sleep(SHORTEST)  # nothing new, and yet at once

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            with contextlib.suppress(HintedError, OSError):
                await client.close()
