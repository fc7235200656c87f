"""Both ends of a link with a secure stream on it: `dial_link`, and `LinkListener` for a mailbox.

Anybody who learned the key of a mailbox may put to it, and may name any mailbox for the answer. So
of OPENs only so many a second are looked at, the handshakes of a mailbox are limited as those of an
address are, and a peer that is not authenticated is sent three times what it sent, at most.
"""

import asyncio
import logging
import secrets
from functools import partial
from typing import Final

from grants.token_bucket import TokenBucket
from rossec.channel.edhoc.credentials import PeerT
from rossec.channel.opening import WireProtocol
from rossec.errors import LinkEnded
from rossec.net.aio.accepted import AcceptedStreams, Handler
from rossec.net.aio.client import authenticate
from rossec.net.aio.stream import SecureStream
from rossec.net.aio.transport import TransportOwner
from rossec.net.context import SecureContext
from rossec.overlay.carriers import FrameCarrier
from rossec.overlay.link import Link
from rossec.overlay.link_frames import LINK_ID, Kind, kind_of, link_of, refusal
from rossec.overlay.link_transport import LinkTransport
from rossec.overlay.mailboxes import BOX, mailbox

_log = logging.getLogger("rossec.overlay.endpoint")
ADDRESS: Final = "a link"  # of the peer, in messages: keys of mailboxes are told to nobody
OPENS_PER_SECOND: Final = 32
PROTOCOL: Final = WireProtocol.HTTP


async def dial_link(
    carrier: FrameCarrier, key: str, seat: str, context: SecureContext[PeerT]
) -> SecureStream[PeerT]:
    """Open a link to a mailbox and authenticate; the caller judges who answered (`peer`).

    Certificates are sent whole: a link is dialled seldom, and lasts.

    Args:
        carrier: the own session with the routers.
        key: the mailbox of the peer.
        seat: the own one, in which a mailbox for the answers is made.
        context: as for `connect`; its deadline of handshakes holds.

    Raises:
        HandshakeTimeout: nobody answers in that mailbox.
        ChannelError: the handshake failed; the leaf says how.
        OverlayUnavailable: the carrier is closed.
    """
    caller = _Caller(carrier, key, mailbox(seat, secrets.token_bytes(BOX)))
    try:
        waiting = authenticate(context.initiator(PROTOCOL), caller.make, ADDRESS)
    except BaseException:
        caller.close()
        raise
    stream = await waiting
    if caller.transport is not None:
        caller.transport.validated()
    return stream


class _Caller:
    """A link that is dialled, and the mailbox where its answers arrive."""

    def __init__(self, carrier: FrameCarrier, key: str, reply_key: str) -> None:
        self._carrier = carrier
        self._key = key
        self._link = Link.open(secrets.token_bytes(LINK_ID), reply_key, _now())
        self.transport: LinkTransport | None = None
        self._reader = carrier.subscribe(reply_key, self._receive)

    def make(self, owner: TransportOwner) -> LinkTransport:
        """The transport, for its owner."""
        self.transport = LinkTransport(self._link, self._key, self._carrier, self.close, owner)
        return self.transport

    def _receive(self, frame: bytes) -> None:
        if self.transport is not None and link_of(frame) == self._link.link_id:
            self.transport.frame_received(frame)

    def close(self) -> None:
        """The answers are read no more."""
        self._reader.close()


class LinkListener(AcceptedStreams[PeerT]):
    """A mailbox in which links arrive; `handler` runs once for each authenticated peer.

    The link ends when the handler returns. Who the peer is, is for the handler to judge.

    Args:
        carrier: the own session with the routers.
        key: the mailbox.
        context: as for `rossec.net.aio.serve`; its limits of half-open connections hold.
        handler: of one authenticated connection.
        address: of the peers, in messages and in those limits: which mailbox they came by.
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
        self._carrier = carrier
        self._address = address
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
        elif kind_of(frame) in {Kind.OPEN, Kind.PROBE} and self._may_look():
            if kind_of(frame) == Kind.OPEN:
                self._open(frame)
            elif (answer := refusal(frame)) is not None:
                self._carrier.put(*answer)

    def _may_look(self) -> bool:
        """Whether a frame of an unknown link is looked at now."""
        if self._looks.refill(_now()) < 1:
            return False
        self._looks.tokens -= 1
        return True

    def _open(self, frame: bytes) -> None:
        try:
            link = Link.accept(frame, _now())
        except LinkEnded as error:
            _log.info("%s refused: %s", self._address, error)
            return
        slot = self._admit(self._address)
        if slot is not None:
            self._begin(partial(self._make, link), self._address, slot)
            self._links[link.link_id].frame_received(frame)

    def _make(self, link: Link, owner: TransportOwner) -> LinkTransport:
        """The transport of an accepted link, found by its frames until it is closed."""
        forget = partial(self._links.__delitem__, link.link_id)
        transport = LinkTransport(link, link.reply_key, self._carrier, forget, owner)
        self._links[link.link_id] = transport
        return transport

    def _on_authenticated(self, stream: SecureStream[PeerT]) -> None:
        if isinstance(stream.transport, LinkTransport):
            stream.transport.validated()
        super()._on_authenticated(stream)

    async def close(self) -> None:
        """Read the mailbox no more, abort every link, wait until the handlers are gone."""
        self._reader.close()
        await super().close()


def _now() -> float:
    return asyncio.get_running_loop().time()
