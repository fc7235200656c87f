"""A node's standing with its master: one control connection, renewed whenever it breaks.

A shell. On every connection the node checks that it speaks to `/master` of its own trust domain,
loads revocations, presents its grants and registers everything again, so that a restarted master
knows it without the node's program noticing. The heartbeat fetches revocations as well: pushes
alone could be suppressed without a trace (RFC 9770 section 11 asks the same).
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable
from typing import Final

from ca.certificates import Identity
from ca.errors import CAError, HintedError, RevocationsStale
from rossec.errors import ConfigurationError, RossecError
from rossec.net.rpc import RpcClient
from rossec.net.stream import SecureStream
from rossec.node.renewal import Call
from rossec.node.slave import MASTER

HEARTBEAT: Final = 10.0
_FIRST_PAUSE: Final = 0.25
_LONGEST_PAUSE: Final = 5.0

_log = logging.getLogger("rossec.node")


async def nothing_proved(_: Call) -> int:
    """For a node that asks for no proofs: where revocations are a tree it stays refused."""
    return 0


class MasterSession:
    """Calls to the master, over a connection that is kept open.

    Args:
        name: the node's own name, the `caller_id` of every call.
        dial: opens a secure stream to the master.
        refresh: takes the newest revocation list and timestamp; raises when they are refused.
        restore: makes every registration again; called on each new connection.
        held: digest of the revocation list this node holds, which then need not be sent; without
            it every answer brings the list.
        prove: asks for the proofs that are wanted; how many came.
    """

    def __init__(
        self,
        name: str,
        dial: Callable[[], Awaitable[SecureStream[Identity]]],
        refresh: Callable[[bytes, bytes, Identity], None],
        restore: Callable[["MasterSession"], Awaitable[None]],
        held: Callable[[], bytes] | None = None,
        prove: Callable[[Call], Awaitable[int]] = nothing_proved,
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

    async def answer(self, method: str, *params: object) -> object:
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
        await self._drop()
        self._client, self._stream = RpcClient(stream), stream
        try:
            await self._beat()
            await self._restore(self)
        except BaseException:  # nobody may go on with a master that did not hold
            await self._drop()
            raise
        return stream

    async def keep(self) -> None:
        """Beat, and connect anew whenever the connection is lost. Runs until cancelled."""
        pause = _FIRST_PAUSE
        while True:
            try:
                if self._client is None or self._client.closed:
                    await self.open()
                    _log.info("%s: connected to the master again", self._name)
                await self._pause()
                await self._beat()
                pause = _FIRST_PAUSE
            except (HintedError, OSError, TimeoutError) as error:
                _log.warning("%s: no answer from the master: %s", self._name, error)
                await self._drop()
                await asyncio.sleep(pause)
                pause = min(2 * pause, _LONGEST_PAUSE)

    async def close(self) -> None:
        """End the control connection; the master then forgets nothing until told to."""
        await self._drop()

    async def _pause(self) -> None:
        """Until the next beat, or until the connection ends: a restarted master is met at once."""
        if self._stream is not None:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(HEARTBEAT):
                    await self._stream.wait_ended()

    async def _drop(self) -> None:
        client, self._client = self._client, None
        if client is not None:
            await client.close()

    async def _beat(self) -> None:
        if self._held is None:
            answer = await self.call("rossec.revocations")
        else:
            answer = await self.call("rossec.revocationsSince", self._held())
        match answer, self._stream:
            case [bytes() as revocations, bytes() as timestamp], SecureStream(peer=master):
                try:
                    self._refresh(revocations, timestamp, master)
                except RevocationsStale:  # of a tree: the master's own key is still unproved
                    if not await self._prove(self.call):
                        raise
                    self._refresh(b"", timestamp, master)
            case _:
                raise CAError("the master has no revocation list", "give it one: rossec ca publish")
