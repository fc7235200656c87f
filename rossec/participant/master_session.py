"""A node's standing with its master: one control connection, renewed whenever it breaks.

A shell. On every connection the node checks that it speaks to `/master` of its own trust domain,
loads revocations, presents its grants and registers everything again, so that a restarted master
knows it without the node's program noticing. The heartbeat fetches revocations as well: pushes
alone could be suppressed without a trace (RFC 9770 section 11 asks the same). To a master that was
rolled back the node hands the newer list it holds: others, who know nothing yet, would believe it.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from secrets import SystemRandom
from typing import Final

from ca.certificates import Identity
from ca.errors import CAError, ClocksDisagree, HintedError, RevocationRefused, RevocationsStale
from ca.revocation.state import digest, open_timestamp
from ca.revocation.tree import is_tree
from rossec import clock
from rossec.errors import AnswerRefused, ConfigurationError, RossecError
from rossec.net.aio import SecureStream
from rossec.net.rpc.client import RpcClient
from rossec.participant.access import NO_LIST
from rossec.participant.grant_renewal import MasterCall
from rossec.participant.retry import Retry
from rossec.participant.slave_api import MASTER
from rossec.ros.xmlrpc import Fault

HEARTBEAT: Final = 10.0

_log = logging.getLogger("rossec.node")


async def no_proofs(_: MasterCall) -> int:
    """For a node that asks for no proofs: where revocations are a tree it stays refused."""
    return 0


class MasterSession:
    """Calls to the master, over a connection that is kept open.

    Args:
        name: the node's own name, the `caller_id` of every call.
        dial: opens a secure stream to the master.
        refresh: takes the newest revocation list and timestamp; raises when they are refused.
        restore: makes every registration again; called on each new connection.
        held: the signed revocation list this node holds, which then need not be sent; without it
            every answer brings the list.
        prove: asks for the proofs that are wanted; how many came.
    """

    def __init__(
        self,
        name: str,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        refresh: Callable[[bytes, bytes, Identity], None],
        restore: Callable[["MasterSession"], Awaitable[None]],
        held: Callable[[], bytes] | None = None,
        prove: Callable[[MasterCall], Awaitable[int]] = no_proofs,
    ) -> None:
        self._name = name
        self._dial = dial
        self._refresh = refresh
        self._restore = restore
        self._held = held
        self._prove = prove
        self._client: RpcClient | None = None
        self._stream: SecureStream[Identity] | None = None

    async def call(self, method: str, *params: object) -> object:
        """Value of `[1, status, value]` that the master answers.

        Raises:
            RossecError: the master refuses, answers nonsense, or is out of reach.
        """
        return await self._connected().ask(method, self._name, *params)

    async def forward(self, method: str, *params: object) -> object:
        """Whole answer to a call whose parameters are complete.

        Raises:
            Fault, RossecError: as of `RpcClient.call`; the master is out of reach.
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
        stream = await self._dial()
        if stream.peer.name != MASTER:
            stream.abort("not the master")
            raise ConfigurationError(
                f"the node at the master's address is {stream.peer.name}, not {MASTER}",
                "check ROS_MASTER_URI",
            )
        await self._disconnect()
        self._client, self._stream = RpcClient(stream), stream
        try:
            await self._heartbeat()
            await self._restore(self)
        except BaseException:  # nobody may go on with a master that did not hold
            await self._disconnect()
            raise
        return stream

    async def run(self) -> None:
        """Beat, and connect anew whenever the connection is lost. Runs until cancelled."""
        retry = Retry(SystemRandom().random)
        while True:
            try:
                if self._client is None or self._client.closed:
                    await self.open()
                    _log.info("%s: connected to the master again", self._name)
                await self._wait_for_heartbeat()
                await self._heartbeat()
                retry.succeeded()
            except (HintedError, OSError, TimeoutError) as error:
                _log.warning("%s: no answer from the master: %s", self._name, error)
                await self._disconnect()
                await asyncio.sleep(retry.pause(asyncio.get_running_loop().time()))

    async def close(self) -> None:
        """End the control connection; the master then forgets nothing until told to."""
        await self._disconnect()

    async def _wait_for_heartbeat(self) -> None:
        """Until the next beat, or until the connection ends: a restarted master is met at once."""
        if self._stream is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(HEARTBEAT):
                    await self._stream.wait_ended()

    async def _disconnect(self) -> None:
        client, self._client = self._client, None
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
        """Bring the master the list this node holds; whether it is newer than the master's.

        Of a tree a node has not the entries, without which it is of no use to the master.
        """
        newest = b"" if self._held is None else self._held()
        if not newest or is_tree(newest):
            return False
        try:
            newer = await self.call("rossec.updateRevocations", newest) == 1
        except (AnswerRefused, Fault) as error:
            _log.warning("%s: the master refuses the list held here: %s", self._name, error)
            return False
        if newer:
            _log.warning(
                "%s: the master had an older revocation list than this node, which has"
                " handed it over: was its home restored from a backup?",
                self._name,
            )
        return newer

    async def _fetch_revocations(self) -> None:
        if self._held is None:
            answer = await self.call("rossec.revocations")
        else:
            answer = await self.call("rossec.revocationsSince", digest(self._held()))
        match answer, self._stream:
            case [bytes() as revocations, bytes() as timestamp], SecureStream(peer=master):
                try:
                    self._apply(revocations, timestamp, master)
                except RevocationsStale:  # of a tree: the master's own key is still unproved
                    if not await self._prove(self.call):
                        raise
                    self._apply(revocations, timestamp, master)
            case _:
                raise CAError(*NO_LIST)

    def _apply(self, revocations: bytes, timestamp: bytes, master: Identity) -> None:
        """Take the news; their time, asked for a moment ago, may correct a clock that was wrong."""
        try:
            self._refresh(revocations, timestamp, master)
        except ClocksDisagree:  # and nothing else: who is revoked, or lies, tells no time
            if not _corrects_clock(timestamp, master):
                raise
            self._refresh(revocations, timestamp, master)
        else:
            _corrects_clock(timestamp, master)


def _corrects_clock(timestamp: bytes, master: Identity) -> bool:
    """Whether the clock of this process was set back, and rightly so by the master's clock.

    Only an answer to the node's own question tells the time: it is as old as the call at most.
    """
    return clock.correct(open_timestamp(timestamp, master.public_key).issued)
