"""A relay and one master of its site: which doors to open, and where targets are. A shell.

The master is polled, so it needs no address of the relay. Only this master decides where a target
is: what a relay of another site asks for is answered from its registrations, or refused.
"""

import asyncio
import contextlib
import logging
from collections.abc import Awaitable, Callable, Collection, Mapping
from secrets import SystemRandom
from typing import Final, Protocol

from ca.certificates import Identity
from ca.domains.aliases import shown
from ca.errors import HintedError
from rossec.errors import (
    AnswerMalformed,
    AnswerRefused,
    RelayRefused,
    RossecError,
    StreamRefused,
)
from rossec.master.state.addresses import is_connectable
from rossec.master.state.doors import Door, Target, Way
from rossec.net.aio import SecureStream
from rossec.net.rpc.client import CallFailed, RpcClient
from rossec.overlay.wanted_doors import Orders, WantedDoors
from rossec.participant.retry import Retry
from rossec.ros.names import RELAY_DOORS, RELAY_TARGET
from rossec.ros.settings import build_door
from rossec.ros.text import printable
from rossec.ros.xmlrpc import Fault

OLD_MASTER: Final = 30.0  # seconds until a master that knows no relays is asked again
_log = logging.getLogger("rossec.overlay")
_Failures: Final = (HintedError, OSError, TimeoutError)

Dial = Callable[[], Awaitable[SecureStream[Identity]]]
"""Connects with the master as the relay, for HTTP; who answers is checked here."""


class DoorTable(Protocol):
    """The doors of this relay. Several masters may want one target: it has one door."""

    async def open(self, target: Target, master: str) -> Door:
        """The door of `target`, opened if there is none, and held for `master`.

        Raises:
            RossecError, OSError: the peer is not known, or no door can be opened.
        """

    def release(self, target: Target, master: str) -> None:
        """`master` wants it no longer: nobody new is let in when no master does."""

    def take_dropped(self, master: str) -> Collection[Target]:
        """What `master` wants and was closed since the last call, as its peer was removed."""

    def ways(self) -> Mapping[str, Way]:
        """How each peer of this relay is reached, by label."""


class MasterLink:
    """One master of the own domain.

    Args:
        name: the name it is certified for.
        relay: the relay's own name.
        instance: random, of this run of the relay.
        dial: connects with the master.
        doors: those of the relay.
        on_masters: called with the masters that this one says shall be polled too.

    Attributes:
        error: why the master is not polled now; empty: it is.
    """

    def __init__(
        self,
        name: str,
        relay: str,
        instance: str,
        dial: Dial,
        doors: DoorTable,
        on_masters: Callable[[Mapping[str, str]], None],
    ) -> None:
        self.name: Final = name
        self.error = ""
        self._relay = relay
        self._instance = instance
        self._dial = dial
        self._doors = doors
        self._on_masters = on_masters
        self._wanted = WantedDoors()
        self._asking: RpcClient | None = None
        self._turn = asyncio.Lock()
        self._retry = Retry(SystemRandom().random)

    async def run(self) -> None:
        """Poll until cancelled; doors stay open while the master is away."""
        try:
            while True:
                pause = await self._poll_until_failure()
                await asyncio.sleep(pause)
        finally:
            for target in self._wanted.held:
                self._doors.release(target, self.name)

    async def close(self) -> None:
        """End the connection on which targets are asked for; `run` has been cancelled."""
        async with self._turn:
            if self._asking is not None:
                await self._asking.close()

    async def target(self, domain: str, kind: str, name: str) -> tuple[str, int]:
        """Host and port of what another relay wants to reach.

        Args:
            domain: the label of that relay's domain; empty: the own one.
            kind, name: a target, by its name here.

        Raises:
            StreamRefused: it is not registered at this master, or not shown to that domain.
            RossecError, OSError, TimeoutError: no answer.
        """
        try:
            answer = await self._ask(domain, kind, name)
        except (AnswerRefused, Fault) as error:
            text = error.faultString if isinstance(error, Fault) else error
            raise StreamRefused(printable(f"{self.name}: {text}")) from error
        match answer:
            case [str() as host, int() as port] if is_connectable(build_door(host, port), "http"):
                return host, port
            case _:
                raise AnswerMalformed(f"{self.name} says that a target is nowhere")

    async def _ask(self, domain: str, kind: str, name: str) -> object:
        for _ in range(2):  # the master ends a connection that was silent for long
            kept = self._asking
            client = await self._client()
            try:
                return await client.ask(RELAY_TARGET, self._relay, domain, kind, name)
            except RossecError:
                if client is not kept or not client.closed:
                    raise
        raise CallFailed(f"{self.name} ends every connection")

    async def _client(self) -> RpcClient:
        """The connection on which targets are asked for: a poll occupies its own."""
        async with self._turn:
            if self._asking is None or self._asking.closed:
                self._asking = RpcClient(await self._connected())
            return self._asking

    async def _connected(self) -> SecureStream[Identity]:
        stream = await self._dial()
        peer = stream.peer
        if peer.is_foreign or peer.wildcard or peer.name != self.name:
            stream.abort("not the master of this relay")
            raise RelayRefused(
                f"{shown(peer.name)} answers at the address of {self.name}",
                "check ROS_MASTER_URI, and the URIs in: rossec federation list",
            )
        return stream

    async def _poll_until_failure(self) -> float:
        """Poll; returns how many seconds to wait before the next attempt."""
        try:
            await self._poll()
        except Fault as fault:
            self._report(f"it is older than this relay, update it: {fault.faultString}")
            return OLD_MASTER
        except _Failures as error:
            hint = error.hint if isinstance(error, HintedError) else ""
            self._report(f"{error} ({hint})" if hint else str(error) or type(error).__name__)
        return self._retry.pause(asyncio.get_running_loop().time())

    async def _poll(self) -> None:
        client = RpcClient(await self._connected())
        try:
            self._wanted.connected()
            while True:
                report = self._wanted.report()
                ways = {peer: way._asdict() for peer, way in self._doors.ways().items()}
                answer = await client.ask(
                    RELAY_DOORS, self._relay, self._instance, self._wanted.seen, report, ways
                )
                orders = self._wanted.take(answer, len(report))
                self._retry.succeeded()
                self.error = ""
                await self._carry_out(orders)
        finally:
            with contextlib.suppress(*_Failures):
                await client.close()

    async def _carry_out(self, orders: Orders) -> None:
        for target in orders.close:
            self._doors.release(target, self.name)
        again = self._wanted.lost(self._doors.take_dropped(self.name))
        for target in (*orders.open, *again):
            try:
                self._wanted.opened(target, await self._doors.open(target, self.name))
            except _Failures as error:
                if self._wanted.failed(target):
                    where = f"{target.name} of {target.peer}"
                    _log.warning("no door for %s: %s", where, printable(error))
        self._on_masters(orders.masters)

    def _report(self, text: str) -> None:
        text = printable(text)
        if text != self.error:
            _log.warning("%s: %s", self.name, text)
        self.error = text
