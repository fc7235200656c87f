"""The link that a relay makes to one peer, while doors to it are used. A shell.

It is dialled when the first connection needs it and kept while it carries any, and a while longer.
A failure is told at once to those who ask soon after: nodes try again by themselves.
"""

import asyncio
import logging
import socket
import time
from collections.abc import Awaitable, Callable
from copy import copy
from enum import Enum
from functools import partial
from typing import Final, TypeAlias

from ca.certificates import Identity
from ca.errors import HintedError
from rossec.errors import (
    ChannelError,
    HandshakeFailed,
    HandshakeTimeout,
    PeerRefused,
    RelayRefused,
    StreamRefused,
)
from rossec.net.aio import SecureStream
from rossec.net.aio.tasks import TaskSet
from rossec.overlay.link_transport import idle_round_trip
from rossec.overlay.mux import Role
from rossec.overlay.mux_units import Target
from rossec.overlay.peers import Peer
from rossec.overlay.streams import Streams
from rossec.ros.text import printable

IDLE_FOR: Final = 300.0  # seconds without a stream, after which a link is closed
_FIRST_PAUSE, _LONGEST_PAUSE = 0.5, 5.0  # seconds between two attempts
_log = logging.getLogger("rossec.overlay")

DialPeer: TypeAlias = Callable[[Peer], Awaitable[SecureStream[Identity]]]
"""Makes a link to a peer, which is that peer and admitted. Raises a `HintedError` or `OSError`."""


class LinkState(Enum):
    """What people are told of a link."""

    IDLE = "idle"
    DIALLING = "dialling"
    LINKED = "linked"
    FAILED = "failed"


class PeerLink:
    """The link to `peer`.

    Args:
        peer: its card is here.
        dial: makes a link.
        clock: monotonic, in seconds.

    Attributes:
        error, hint: why there is no link, though one was wanted; else empty.
    """

    def __init__(
        self, peer: Peer, dial: DialPeer, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.peer: Final = peer
        self.error = self.hint = ""
        self._dial = dial
        self._clock = clock
        self._tasks = TaskSet()
        self._stream: SecureStream[Identity] | None = None
        self._streams: Streams | None = None
        self._carrying: asyncio.Task[None] | None = None
        self._dialling: asyncio.Task[Streams | RelayRefused] | None = None
        self._pause = 0.0
        self._said = ""  # in the log, of a failure that goes on
        self._not_before = 0.0

    @property
    def state(self) -> LinkState:
        """Where it is."""
        if self._dialling is not None:
            return LinkState.DIALLING
        if self._streams is not None:
            return LinkState.LINKED
        return LinkState.FAILED if self.error else LinkState.IDLE

    @property
    def stream(self) -> SecureStream[Identity] | None:
        """The link, if there is one."""
        return self._stream

    @property
    def carried(self) -> int:
        """How many connections it carries."""
        return 0 if self._streams is None else len(self._streams)

    async def carry(self, target: Target, sock: socket.socket) -> None:
        """Carry this connection to `target` at the peer's site until it is over. Owns `sock`.

        Raises:
            HintedError: there is no link, or no room in it; `sock` is closed.
        """
        try:
            streams = await self._open_streams()
        except BaseException:
            sock.close()
            raise
        await streams.carry(target, sock)

    def tick(self) -> None:
        """Close a link that was not used for long; called once in a second."""
        since = None if self._streams is None else self._streams.idle_since
        if since is not None and self._clock() - since > IDLE_FOR and self._carrying is not None:
            self._settle()
            self._carrying.cancel()

    async def close(self) -> None:
        """End the link, and what it carries."""
        await self._tasks.close()

    # -- making one

    async def _open_streams(self) -> Streams:
        if self._streams is not None and not self._streams.used_up:
            return self._streams
        if self._dialling is None:
            if self._clock() < self._not_before:
                raise RelayRefused(self.error, self.hint)
            self._dialling = self._tasks.spawn(self._make(), f"dialling {self.peer.label}")
            self._dialling.add_done_callback(self._dialled)
        found = await asyncio.shield(self._dialling)
        if isinstance(found, RelayRefused):
            raise copy(found)  # others wait for it too
        return found

    async def _make(self) -> Streams | RelayRefused:
        """The streams of a new link; or why there is none, for all who wait."""
        try:
            stream = await self._dial(self.peer)
        except (TimeoutError, HandshakeTimeout):  # nobody reads that mailbox
            return self._failed(f"{self.peer.label} does not answer", _SILENT)
        except HintedError as error:
            return self._failed(str(error), error.hint)
        except OSError as error:
            return self._failed(f"no link to {self.peer.label}: {error}", _SILENT)
        self.error = self.hint = ""
        self._not_before = 0.0
        streams = Streams(
            stream, Role.CALLER, self.peer.label, round_trip=partial(idle_round_trip, stream)
        )
        self._stream, self._streams = stream, streams
        self._carrying = self._tasks.spawn(self._run(stream, streams), f"to {self.peer.label}")
        _log.info("link to %s", self.peer.label)
        return streams

    def _dialled(self, _: object) -> None:
        self._dialling = None

    def _failed(self, text: str, hint: str) -> RelayRefused:
        self._pause = min(max(2 * self._pause, _FIRST_PAUSE), _LONGEST_PAUSE)
        self._not_before = self._clock() + self._pause
        self.error, self.hint = printable(text), printable(hint)
        if self.error != self._said:
            _log.warning("no link to %s: %s (%s)", self.peer.label, self.error, self.hint)
        self._said = self.error
        return RelayRefused(self.error, self.hint)

    def _settle(self) -> None:
        """There was a link: a failure from now on is another one."""
        self._pause, self._said = 0.0, ""

    async def _run(self, stream: SecureStream[Identity], streams: Streams) -> None:
        try:
            await streams.run()
        except (HandshakeFailed, PeerRefused) as error:  # whoever is called judges last
            if self._stream is stream:
                self._failed(str(error), _ENDED)
        except (ChannelError, StreamRefused) as error:
            _log.warning("the link to %s ended: %s", self.peer.label, printable(error))
            if self._stream is stream:
                self.error, self.hint = printable(error), _ENDED
                self._settle()
        finally:
            if self._stream is stream:
                self._stream = self._streams = self._carrying = None


_SILENT: Final = (
    "does its relay run, does it have the newest card of this one, and is a router in reach?"
)
_ENDED: Final = (
    "the other relay's log says why; it must trust this domain (there: rossec domain list) and have"
    " this relay's card (there: rossec relay list)"
)
