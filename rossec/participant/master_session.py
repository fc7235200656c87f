"""A node's session with its master: one control connection, opened again whenever it is lost.

On every connection the node checks that the peer is its master in its own trust domain, loads
revocations, presents its grants and registers everything again, so that a master can restart
without the node's program noticing. The heartbeat fetches revocations as well: pushed updates alone
could be suppressed unnoticed (RFC 9770 section 11 requires the same). A master whose list was
rolled back receives the newer one this node holds, as new nodes would accept the old one.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from secrets import SystemRandom
from typing import Final

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import CAError, ClocksDisagree, HintedError, RevocationRefused, RevocationsStale
from ca.revocation.state import digest, open_timestamp
from ca.revocation.tree import is_tree
from rossec import clock
from rossec.environment import OWN_MASTER
from rossec.errors import AnswerRefused, ChannelError, ConfigurationError, RossecError
from rossec.net.aio import SecureStream, as_master
from rossec.net.rpc.client import RpcClient
from rossec.participant.access import NO_LIST
from rossec.participant.grant_renewal import MasterCall
from rossec.participant.retry import Retry
from rossec.ros.names import MASTER
from rossec.ros.xmlrpc import Fault

HEARTBEAT: Final = 10.0
_SAID_AGAIN: Final = 60.0  # seconds after which a cause that lasts is logged again

_log = logging.getLogger("rossec.node")


class MasterSession:
    """Calls to the master, over a connection that is kept open.

    Args:
        name: the node's own name, the `caller_id` of every call.
        dial: opens a secure stream to the master.
        refresh: takes the newest revocation list and timestamp; raises when they are refused.
        restore: makes every registration again; called on each new connection.
        held: the signed revocation list this node holds, which the master then need not send.
        prove: requests the proofs that are wanted; returns how many were accepted.
        master: the certified name of the node's own master.
        follow: called after each heartbeat, for what else the node keeps current.
        explain: the cause of a failure that the node knows itself; empty: what the error says.
    """

    def __init__(
        self,
        name: str,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        refresh: Callable[[bytes, bytes, Identity], None],
        restore: Callable[["MasterSession"], Awaitable[None]],
        held: Callable[[], bytes],
        prove: Callable[[MasterCall], Awaitable[int]],
        master: str = MASTER,
        follow: Callable[[MasterCall], Awaitable[None]] | None = None,
        explain: Callable[[], str] = str,
    ) -> None:
        self._name = name
        self._dial = dial
        self._refresh = refresh
        self._restore = restore
        self._held = held
        self._prove = prove
        self._master = master
        self._follow = follow
        self._explain = explain
        self._client: RpcClient | None = None
        self._stream: SecureStream[Identity] | None = None
        self._is_restored = False

    @property
    def is_open(self) -> bool:
        """Whether there is a connection on which everything is registered."""
        return self._is_restored and self._client is not None and not self._client.closed

    async def call(self, method: str, *params: object) -> object:
        """The value in the master's answer `[1, status, value]`.

        Raises:
            RossecError: the master refuses, sends a malformed answer, or is out of reach.
        """
        return await self._connected().ask(method, self._name, *params)

    async def forward(self, method: str, *params: object) -> object:
        """The whole answer to a call whose parameters include the caller_id.

        Raises:
            Fault, RossecError: see `RpcClient.call`; the master is out of reach.
        """
        return await self._connected().call(method, *params)

    def _connected(self) -> RpcClient:
        if self._client is None or self._client.closed:
            raise RossecError("the master is out of reach", "is `rossec master` running there?")
        return self._client

    async def open(self) -> SecureStream[Identity]:
        """Connect and restore everything; returns the new control connection.

        Raises:
            HintedError, OSError: the master is out of reach, is not the master, or refuses.
        """
        try:
            stream = await self._dial()
        except ChannelError as error:
            raise as_master(error) from error
        if stream.peer.name != self._master:
            stream.abort("not the master")
            found = shown(stream.peer.name)
            raise ConfigurationError(
                f"the node at the master's address is {found}, not {self._master}",
                f"check ROS_MASTER_URI, and {OWN_MASTER} if there are several masters",
            )
        await self._disconnect()
        self._client, self._stream = RpcClient(stream), stream
        try:
            await self._heartbeat()
            await self._restore(self)
        except BaseException:  # no caller may use a session that failed to open
            await self._disconnect()
            raise
        self._is_restored = True
        return stream

    async def run(self) -> None:
        """Send heartbeats, and reconnect whenever the connection is lost. Runs until cancelled."""
        retry = Retry(SystemRandom().random)
        said, said_at = "", 0.0
        while True:
            try:
                if self._client is None or self._client.closed:
                    await self.open()
                    _log.info("%s: connected to the master again", self._name)
                await self._wait_for_heartbeat()
                await self.refresh()
                retry.succeeded()
                said = ""
            except (HintedError, OSError, Fault) as error:
                text, now = self._explain() or str(error), asyncio.get_running_loop().time()
                if text != said or now - said_at >= _SAID_AGAIN:
                    _log.warning("%s: no answer from the master: %s", self._name, text)
                    said, said_at = text, now
                await self._disconnect()
                await asyncio.sleep(retry.pause(now))

    async def refresh(self) -> None:
        """Send a heartbeat now: what the master holds that is new is taken.

        Raises:
            HintedError, OSError, Fault: no answer, or what it has is refused.
        """
        await self._heartbeat()
        if self._follow is not None:
            await self._follow(self.call)

    async def close(self) -> None:
        """Close the control connection; registrations at the master stay."""
        await self._disconnect()

    async def _wait_for_heartbeat(self) -> None:
        """Wait until the next heartbeat is due or the connection ends: then reconnect at once."""
        if self._stream is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(HEARTBEAT):
                    await self._stream.wait_ended()

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
        self._is_restored = False
        if client is not None:
            await client.close()

    async def _heartbeat(self) -> None:
        try:
            await self._fetch_revocations()
        except RevocationRefused:
            if not await self._send_held_list():
                raise
            await self._fetch_revocations()

    async def _send_held_list(self) -> bool:
        """Send the master the list this node holds; returns whether it is newer than the master's.

        Of a tree a node does not have the entries, which the master needs.
        """
        newest = self._held()
        if not newest or is_tree(newest):
            return False
        try:
            newer = await self.call("rossec.updateRevocations", newest) == 1
        except (AnswerRefused, Fault) as error:
            _log.warning(
                "%s: the master refuses this node's revocation list: %s", self._name, error
            )
            return False
        if newer:
            _log.warning(
                "%s: the master had an older revocation list than this node, and has received"
                " the newer one: was its home restored from a backup?",
                self._name,
            )
        return newer

    async def _fetch_revocations(self) -> None:
        answer = await self.call("rossec.revocationsSince", digest(self._held()))
        match answer, self._stream:
            case [bytes() as revocations, bytes() as timestamp], SecureStream(peer=master):
                try:
                    self._apply(revocations, timestamp, master)
                except RevocationsStale:  # of a tree: the master's own key has no proof yet
                    if not await self._prove(self.call):
                        raise
                    self._apply(revocations, timestamp, master)
            case _:
                raise CAError(*NO_LIST)

    def _apply(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take the list and timestamp; a timestamp just requested may correct a wrong clock."""
        try:
            self._refresh(revocations, timestamp, master)
        except ClocksDisagree:  # only then: a revoked master sets no clock
            if not _corrects_clock(timestamp, master):
                raise
            self._refresh(revocations, timestamp, master)
        else:
            _corrects_clock(timestamp, master)


def _corrects_clock(timestamp: bytes, master: Identity) -> bool:
    """Set the clock of this process by the master's, if that is right; returns whether it was.

    Only the answer to the node's own call may do so: it is at most as old as the call.
    """
    return clock.correct(open_timestamp(timestamp, master.public_key).issued)
