"""Short visits of a thing's identity to its master: a resting thing holds no connection there.

The border router itself has a session and receives what is signed and new; all identities of the
process share that. A thing's own identity connects to register, to fetch and to renew its grants,
and disconnects when nothing was called for a while. Registrations stay, as those of rospy do.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import CAError, HintedError
from ca.revocation.state import digest
from rossec import clock
from rossec.border.shared import SharedIdentity
from rossec.errors import AnswerRefused, ConfigurationError
from rossec.net.aio import SecureStream
from rossec.net.rpc.client import RpcClient
from rossec.participant.access import NO_LIST, Access
from rossec.participant.grant_delivery import GrantDelivery
from rossec.participant.grant_directory import GrantDirectory
from rossec.participant.grant_renewal import Renewals, due_at, renew
from rossec.participant.presentation import MAX_CALL, batches
from rossec.ros.names import PRESENT_GRANTS
from rossec.ros.xmlrpc import Fault

IDLE: Final = 2.0  # seconds without a call until the connection is closed

_log = logging.getLogger("rossec.border")


class MasterVisits:
    """Calls of one identity to the master.

    Args:
        name: of the thing, the `caller_id` of its calls.
        dial: opens a secure stream to the master.
        access: the grants of the thing; its revocation data is the border router's.
        holder: the thumbprint of its key.
        directory: the grants in its directory.
        shared: what it shares with the other identities.
    """

    __slots__ = (
        "_access", "_client", "_dial", "_directory", "_holder", "_idle", "_lock", "_name",
        "_renewals", "_shared", "_used",
    )  # fmt: skip

    def __init__(
        self,
        name: str,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        access: Access,
        holder: bytes,
        directory: GrantDirectory,
        shared: SharedIdentity,
    ) -> None:
        self._name = name
        self._dial = dial
        self._access = access
        self._holder = holder
        self._directory = directory
        self._shared = shared
        self._renewals = Renewals(access)
        self._client: RpcClient | None = None
        self._idle: asyncio.TimerHandle | None = None
        self._lock = asyncio.Lock()
        self._used = 0

    @property
    def is_open(self) -> bool:
        """Whether there is a connection now."""
        return self._client is not None and not self._client.closed

    def renewal_is_due(self, now: int) -> bool:
        """Whether a grant is to be renewed."""
        return any(
            due_at(held) <= now < held.grant.cap and held.grant.expires < held.grant.cap
            for held in self._access.held_grants()
        )

    async def call(self, method: str, *params: object) -> object:
        """The value of the master's answer.

        Raises:
            HintedError, OSError, TimeoutError, Fault: refused, or out of reach.
        """
        client = await self._connected()
        self._used += 1
        try:
            return await client.ask(method, self._name, *params)
        finally:
            self._used -= 1
            self._rest()

    async def update(self) -> int:
        """Fetch and renew grants; returns how many are new or renewed. Raises as `call`."""
        if self.is_open:  # a new connection presents all: what came from the disk since
            await self.present(self._access.current(clock.now())[:MAX_CALL])
        await self._connected()
        standing = self._shared.standing
        delivery = GrantDelivery(standing, self._holder, self._access, self._directory)
        await delivery.fetch(self.call)
        renewed = await renew(self.call, self._renewals, clock.now())
        await self.present(delivery.take_new())
        await delivery.save()
        return delivery.taken + renewed

    async def present(self, grants: list[bytes]) -> None:
        """Present grants to the master, if there is a connection; a new one presents all."""
        if self.is_open:
            for batch in batches(grants):
                await self.call(PRESENT_GRANTS, batch)

    async def close(self) -> None:
        """Disconnect."""
        client, self._client = self._client, None
        if self._idle is not None:
            self._idle.cancel()
            self._idle = None
        if client is not None:
            with contextlib.suppress(HintedError, OSError):
                await client.close()

    async def _connected(self) -> RpcClient:
        async with self._lock:
            if self._client is None or self._client.closed:
                async with self._shared.turns:
                    self._client = await self._open()
            self._rest()
            return self._client

    async def _open(self) -> RpcClient:
        stream = await self._dial()
        if stream.peer.name != self._shared.master:
            stream.abort("not the master")
            raise ConfigurationError(f"{shown(stream.peer.name)} answers at the master's address")
        client = RpcClient(stream)
        try:
            await self._confirm(client, stream.peer)
            for batch in batches(self._access.current(clock.now())[:MAX_CALL]):
                await client.ask(PRESENT_GRANTS, self._name, batch)
        except BaseException:
            await client.close()
            raise
        return client

    async def _confirm(self, client: RpcClient, master: Identity) -> None:
        """Take the master's timestamp: it is this master, and its key may renew grants."""
        answer = await client.ask(
            "rossec.revocationsSince", self._name, digest(self._shared.held_list())
        )
        match answer:
            case [bytes() as revocations, bytes() as timestamp]:
                self._access.update_revocations(
                    revocations, timestamp, master, clock.now(), self._shared.persist
                )
            case _:
                raise CAError(*NO_LIST)

    def _rest(self) -> None:
        """Disconnect when nothing is called for a while."""
        if self._idle is not None:
            self._idle.cancel()
        self._idle = asyncio.get_running_loop().call_later(IDLE, self._disconnect)

    def _disconnect(self) -> None:
        if self._used:
            self._rest()
            return
        self._idle = None
        client, self._client = self._client, None
        if client is not None:
            self._shared.tasks.spawn(client.close(), f"{self._name}: leaving the master")


async def quietly(work: Awaitable[object], what: str) -> bool:
    """Await `work`; a refusal or an unreachable master is logged. Returns whether it was done."""
    try:
        await work
    except (AnswerRefused, HintedError, OSError, TimeoutError, Fault) as error:
        _log.warning("%s: %s", what, error)
        return False
    return True
