"""Both ends of a link with a secure stream on it: `dial_link`, and `LinkListener` for an inbox."""

import asyncio
import logging
import secrets
from collections import deque
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Final, Protocol

from ca.certificates import Identity
from grants.limits import TokenBucket
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.channel.records import Bytes
from rossec.errors import LinkEnded
from rossec.net.aio.client import authenticate
from rossec.net.aio.server import AcceptedStreams, Handler
from rossec.net.aio.stream import SecureStream
from rossec.net.aio.transport import BaseStream, TransportOwner
from rossec.net.context import SecureContext
from rossec.overlay.documents import Routers
from rossec.overlay.link import ENDED, Link, LinkStats
from rossec.overlay.link_frames import BOX, LINK_ID, LinkFrameKind, inbox, kind_of, link_of, refusal
from rossec.overlay.zenoh_carrier import Carrier

STALLED: Final = 15.0  # seconds: half of what a link endures
_log = logging.getLogger("rossec.overlay.endpoint")
ADDRESS: Final = "a link"  # of the peer, in messages: keys of inboxes are told to nobody
OPENS_PER_SECOND: Final = 32
PROTOCOL: Final = WireProtocol.HTTP


class InboxReader(Protocol):
    def close(self) -> None: ...


class FrameCarrier(Protocol):
    @property
    def heard_at(self) -> float: ...

    def put(self, key: str, data: bytes) -> None:
        # Send a frame to an inbox; never raises for one that is lost.
        ...

    def subscribe(self, key: str, callback: Callable[[bytes], None]) -> InboxReader: ...
    def reopen(self) -> None: ...


class LinkTransport:
    """The link of one connection as its transport (`net.aio.transport`); starts at the first write.

    What the owner does not read is not told to the link as consumed, so its window closes and the
    peer waits, as a kernel's would. `on_closed` is called once, when no frame is wanted any more.
    """

    def __init__(
        self,
        link: Link,
        key: str,
        carrier: FrameCarrier,
        on_closed: Callable[[], None],
        owner: TransportOwner,
    ) -> None:
        self.link = link
        self.local_address = ""  # nobody who comes by a link is near
        self.reason: LinkEnded | None = None  # why the link ended, if not in order
        self.closed = False
        self._key, self._carrier, self._on_closed = key, carrier, on_closed
        self._owner = owner
        self._loop = asyncio.get_running_loop()
        self._arrived: deque[Bytes] = deque()
        self._timer: asyncio.TimerHandle | None = None
        self._reading = self._lagging = self._flush_due = self._ending = False

    # -- frames

    def frame_received(self, frame: bytes) -> None:
        if self.closed:
            return
        try:
            self._arrived.extend(self.link.receive(frame, self._loop.time()))
        except LinkEnded as error:
            self._break(error)
            return
        except BaseException:  # a bug: nothing more passes
            self.abort()
            raise
        if self._arrived:
            self._deliver()
        self._flush_soon()

    def validated(self) -> None:
        if not self.closed:
            self.link.validated()
            self._flush_soon()

    def _flush_soon(self) -> None:
        if not self._flush_due:
            self._flush_due = True
            self._loop.call_soon(self._flush)

    def _flush(self) -> None:
        self._flush_due = False
        self._deliver()  # what came while the owner did not read
        if self.closed:
            return
        self._send()
        if self._lagging and self.link.backlog == 0:
            self._lagging = False
            self._owner.resume_writing()
        self._settle()

    def _settle(self) -> None:
        if self.closed:  # the owner may end it in each of its calls
            return
        link = self.link
        if link.peer_ended and self._reading and not self._arrived and not self._ending:
            self._ending = True
            self._reading = False
            self._owner.eof_received()
            self.finish()
        elif link.state in ENDED:
            self._close()

    def _send(self) -> None:
        link, put = self.link, self._carrier.put
        for frame in link.frames_to_send(self._loop.time()):
            put(self._key, frame)
        deadline = link.deadline()
        if deadline is not None and (self._timer is None or deadline < self._timer.when()):
            if self._timer is not None:
                self._timer.cancel()
            self._timer = self._loop.call_at(deadline, self._on_timer)

    # -- reading

    @property
    def reading(self) -> bool:
        return self._reading

    def resume_reading(self) -> None:
        if not (self._reading or self._ending or self.closed):
            self._reading = True
            if self._arrived or self.link.peer_ended:
                self._flush_soon()

    def pause_reading(self) -> None:
        self._reading = False

    def _deliver(self) -> None:
        arrived, link = self._arrived, self.link
        while arrived and self._reading and not self.closed:
            piece = arrived.popleft()
            buffer = self._owner.get_buffer()
            count = len(piece)
            if count > len(buffer):
                count = len(buffer)
                arrived.appendleft(memoryview(piece)[count:])
                piece = memoryview(piece)[:count]
            buffer[:count] = piece
            link.consumed(count, self._loop.time())
            try:
                self._owner.buffer_updated(count)
            except BaseException:  # a bug, perhaps in a guard: nothing more passes
                self.abort()
                raise

    # -- writing

    def limit_unsent(self) -> None:
        """Nothing to do: what the link's window does not take waits in `backlog`."""

    @property
    def backlog(self) -> int:
        return self.link.backlog

    @property
    def writable(self) -> bool:
        return self.link.writable

    def write(self, data: Bytes) -> None:
        if self.closed:
            return
        self.link.write(data, self._loop.time())
        self._send()
        if self.link.backlog:
            self._lagging = True

    # -- ends

    def write_eof(self) -> None:
        if not self.closed:
            self.link.finish(self._loop.time())
            self._flush_soon()

    def finish(self) -> None:
        self._ending, self._reading = True, False
        self.write_eof()

    def disconnect(self) -> None:
        self.abort()

    def abort(self) -> None:
        if self.closed:
            return
        if self.link.state not in ENDED:
            self._carrier.put(self._key, self.link.reset())
        self._close()

    def _break(self, error: LinkEnded) -> None:
        self.reason = error.bare()
        for frame in self.link.frames_to_send(self._loop.time()):
            self._carrier.put(self._key, frame)
        self._close()

    def _close(self) -> None:
        self.closed = True
        self._reading = False
        self._arrived.clear()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._on_closed()
        self._loop.call_soon(self._owner.connection_lost)
        del self._owner, self._on_closed  # no reference cycle with the owner

    # -- time

    def _on_timer(self) -> None:
        self._timer = None
        now = self._loop.time()
        try:
            self.link.tick(now)
        except LinkEnded as error:
            self._break(error)
            return
        # Nothing at all came from the routers: the session with them is at fault, not the link.
        since = self.link.silent_since
        if since is not None and now - max(since, self._carrier.heard_at) > STALLED:
            self._carrier.reopen()
        self._flush()


def idle_round_trip(stream: BaseStream) -> float:
    """The shortest round trip of the link under a stream; 0: none yet, or it is not over a link."""
    transport = stream.transport
    return transport.link.stats.least_s if isinstance(transport, LinkTransport) else 0.0


def stats_of(stream: BaseStream) -> LinkStats:
    if not isinstance(stream.transport, LinkTransport):
        raise TypeError("this connection is not over a link")
    return stream.transport.link.stats


async def dial_link(
    carrier: FrameCarrier, key: str, account: str, context: SecureContext[PeerT]
) -> SecureStream[PeerT]:
    """Open a link to an inbox and authenticate; the caller judges who answered (`peer`)."""
    # An inbox of its own for each link: who knows the one of before learns nothing of this one (section 2).
    reply_key = inbox(account, secrets.token_bytes(BOX))
    link = Link.open(secrets.token_bytes(LINK_ID), reply_key, _now())
    transport: LinkTransport | None = None

    def receive(frame: bytes) -> None:
        if transport is not None and link_of(frame) == link.link_id:
            transport.frame_received(frame)

    def make(owner: TransportOwner) -> LinkTransport:
        nonlocal transport
        transport = LinkTransport(link, key, carrier, reader.close, owner)
        return transport

    reader = carrier.subscribe(reply_key, receive)
    try:
        waiting = authenticate(context.initiator(PROTOCOL), make, ADDRESS)
    except BaseException:
        reader.close()
        raise
    stream = await waiting
    if isinstance(stream.transport, LinkTransport):
        stream.transport.validated()
    return stream


class LinkListener(AcceptedStreams[PeerT]):
    """An inbox in which links arrive; `handler` runs once for each authenticated peer.

    The link ends when the handler returns. Who the peer is, is for the handler to judge. `address`
    is that of the peers, in messages and in the context's limits: which inbox they came by.
    """

    def __init__(
        self,
        carrier: FrameCarrier,
        key: str,
        context: SecureContext[PeerT],
        handler: Handler[PeerT],
        *,
        address: str = ADDRESS,
    ) -> None:
        super().__init__(handler, context, PROTOCOL)
        self._carrier, self._address = carrier, address
        self._links: dict[bytes, LinkTransport] = {}
        self._looks = TokenBucket(OPENS_PER_SECOND, OPENS_PER_SECOND)
        self._reader = carrier.subscribe(key, self._receive)

    def _receive(self, frame: bytes) -> None:
        link_id = link_of(frame)
        if link_id is None:
            return
        transport = self._links.get(link_id)
        if transport is not None:
            transport.frame_received(frame)
        elif kind_of(frame) in {LinkFrameKind.OPEN, LinkFrameKind.PROBE} and self._looks.refill(_now()) >= 1:
            # Whoever knows the inbox may put to it: only so many frames of unknown links cost anything.
            self._looks.tokens -= 1
            if kind_of(frame) == LinkFrameKind.OPEN:
                self._open(frame)
            elif (answer := refusal(frame)) is not None:
                self._carrier.put(*answer)

    def _open(self, frame: bytes) -> None:
        try:
            link = Link.accept(frame, _now())
        except LinkEnded as error:
            _log.info("%s refused: %s", self._address, error)
            return

        def make(owner: TransportOwner) -> LinkTransport:
            forget = partial(self._links.__delitem__, link.link_id)
            transport = LinkTransport(link, link.reply_key, self._carrier, forget, owner)
            self._links[link.link_id] = transport
            return transport

        # The same limits as at a port: half-open handshakes of this inbox, as of an address (section 2).
        slot = self._admit(self._address)
        if slot is not None:
            self._begin(make, self._address, slot)
            self._links[link.link_id].frame_received(frame)

    def _on_authenticated(self, stream: SecureStream[PeerT]) -> None:
        if isinstance(stream.transport, LinkTransport):
            stream.transport.validated()
        super()._on_authenticated(stream)

    async def close(self) -> None:
        self._reader.close()
        await super().close()


def _now() -> float:
    return asyncio.get_running_loop().time()


class RouterNetwork:
    """A carrier and the identity whose links it carries."""

    def __init__(self, carrier: Carrier, routers: Routers, context: SecureContext[Identity]) -> None:
        self.account: Final = routers.account
        self._carrier, self._context = carrier, context

    @property
    def router(self) -> str:
        return self._carrier.router

    async def dial(self, inbox: str) -> SecureStream[Identity]:
        return await dial_link(self._carrier, inbox, self.account, self._context)

    def listen(
        self, inbox: str, serve: Callable[[SecureStream[Identity]], Awaitable[None]], label: str
    ) -> LinkListener[Identity]:
        """Call `serve` with each authenticated link that arrives in this inbox.

        Unfinished handshakes are limited for each `label`, that of the peer it was told to.
        """
        return LinkListener(self._carrier, inbox, self._context, serve, address=f"a link from {label}")
